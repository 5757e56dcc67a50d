"""Random frames of noisy logs: is the fitted frame within 0.2 m and 0.2 degrees of the true one, or refused?

    fleetlog simulate --site MAP --truck TRUCK --vehicles 5 --duration 1h --seed 5 -o DATASET
    python tests/proofs/random_frames.py DATASET... [--frames 100] [--first 0]

Every frame takes one of the datasets, one to all of its trucks, 5 to 60 minutes of them, and a noise of 0.1 to 2 m,
half of whose variance lasts for 20 s, as that of satellite positions does; and sees it in a frame that is turned by any
angle and shifted by up to 500 m.  The error is that of the log's worst place.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.site import MapFrame
from fleetlog.errors import DataError
from fleetlog.ingest.align import align

Track = tuple[np.ndarray, np.ndarray]
"""Seconds (n,) and places in the site (n, 2) [m]."""
METRES, DEGREES = 0.2, 0.2
NOISES, MINUTES = (0.1, 0.3, 1.0, 2.0), (5.0, 15.0, 30.0, 60.0)
LASTING = 20.0


@dataclass(frozen=True)
class Outcome:
    """A frame: worst error [m] and that of the rotation [degrees]; why it was refused, if it was."""

    metres: float = np.nan
    degrees: float = np.nan
    refused: str = ""

    @property
    def kind(self) -> str:
        near = self.metres < METRES and self.degrees < DEGREES
        return "refused" if self.refused else "found" if near else "WRONG"


def noise_of(rng: np.random.Generator, time: np.ndarray, sd: float) -> np.ndarray:
    """(n, 2) errors of positions, half of the variance white and half lasting."""
    out = rng.normal(0.0, 1.0, (len(time), 2))
    for i, keep in enumerate(np.exp(-np.diff(time) / LASTING), start=1):
        out[i] = keep * out[i - 1] + np.sqrt(1.0 - keep * keep) * out[i]
    return sd * np.sqrt(0.5) * (out + rng.normal(0.0, 1.0, out.shape))


def seen_from(frame: MapFrame, xy: np.ndarray) -> Track:
    """What a log in ``frame`` says of places of the site."""
    c, s = np.cos(frame.rotation), np.sin(frame.rotation)
    x, y = (xy - np.array(frame.shift)).T
    return c * x + s * y, -s * x + c * y


def random_frame(rng: np.random.Generator) -> MapFrame:
    return MapFrame("truth", tuple(rng.uniform(-500.0, 500.0, 2)), float(rng.uniform(-np.pi, np.pi)))


def aligned(rng: np.random.Generator, tracks: list[Track], network: Network, noise: float) -> Outcome:
    """One frame, drawn at random."""
    truth = random_frame(rng)
    logs = [seen_from(truth, xy + noise_of(rng, time, noise)) for time, xy in tracks]
    try:
        found = align(logs, network).frame
    except DataError as error:
        return Outcome(refused=error.what)
    worst = 0.0
    for _, xy in tracks:
        x, y = found.to_site(*seen_from(truth, xy))
        worst = max(worst, float(np.hypot(x - xy[:, 0], y - xy[:, 1]).max()))
    turn = np.remainder(found.rotation - truth.rotation + np.pi, 2.0 * np.pi) - np.pi
    return Outcome(worst, abs(float(np.degrees(turn))))


def some_of(rng: np.random.Generator, tracks: list[Track], minutes: float) -> list[Track]:
    """One to all of the tracks, from a time at random."""
    count = int(rng.integers(1, len(tracks) + 1))
    begin = rng.uniform(0.0, max(3600.0 - 60.0 * minutes, 0.0))
    picked = (tracks[i] for i in rng.permutation(len(tracks))[:count])
    parts = ((t, xy, (t >= begin) & (t <= begin + 60.0 * minutes)) for t, xy in picked)
    return [(t[use], xy[use]) for t, xy, use in parts if use.sum() > 1]


def main() -> None:
    from fleetlog.store.dataset import Dataset

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("datasets", nargs="+")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    sources = []
    for name in options.datasets:
        dataset = Dataset(name)
        days = dataset.days(("x", "y"))
        tracks = [
            (t.seconds() - t.seconds()[0], np.column_stack([t.floats("x"), t.floats("y")])) for t in days
        ]
        sources.append((dataset.path.name, tracks, dataset.site.roads()))
    counts: Counter[str] = Counter()
    for k in range(options.first, options.first + options.frames):
        rng = np.random.default_rng(k)
        name, tracks, network = sources[k % len(sources)]
        noise, minutes = float(rng.choice(NOISES)), float(rng.choice(MINUTES))
        some = some_of(rng, tracks, minutes)
        found = aligned(rng, some, network, noise)
        counts[found.kind] += 1
        what = found.refused or f"{found.metres:.3f} m, {found.degrees:.3f} degrees"
        print(
            f"{k} {name}, {noise} m, {len(some)} trucks, {minutes:.0f} min: {found.kind}, {what}", flush=True
        )
    print(dict(counts))


if __name__ == "__main__":
    main()
