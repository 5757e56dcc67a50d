"""What was found without a column, held against that column."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.discovery.hypotheses.cells import Squares
from fleetlog.discovery.report.fields import Values
from fleetlog.physics.motion.rows import updates
from fleetlog.physics.power import all_terms
from tests.proofs.public_logs import Log

Floats = NDArray[np.float64]

PIECE = 1000.0
"""Length of road over which slopes are compared [m]."""
STEP = 20.0
"""Between the points of a profile [m]."""
NEAR = 250.0
"""Both ends of two pieces of the same road are within this [m]."""
SILENCE = 60.0
"""Seconds without a row that part two runs."""


@dataclass(frozen=True)
class Profile:
    """One run: (N,) distance [m], withheld altitude [m], slope found; (P,) middle, slopes and error of pieces of ``PIECE``."""

    distance: Floats
    altitude: Floats
    middle: Floats
    found: Floats
    error: Floats
    recorded: Floats
    place: Floats
    """(P, 2) where the pieces begin and (P, 2) where they end [m], side by side."""


@dataclass(frozen=True)
class Class:
    """One trip: its label, and what was found of its own with its interval: a share of the weight ("1"), or W."""

    label: str
    value: float
    low: float
    high: float
    metres: float
    unit: str


def travelled(track: Trajectory) -> Floats:
    """(N,) metres driven since the first row, from the speed channel."""
    t, v = track.seconds(), np.nan_to_num(track.floats("speed"))
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])


def placed(track: Trajectory) -> Trajectory:
    """The track with the positions and headings of rows without an update interpolated along the distance driven."""
    fresh = updates(track.seconds(), *(track.floats(c) for c in ("x", "y", "speed")))
    if fresh.all() or fresh.sum() < 2:
        return track
    s = travelled(track) + 1e-6 * np.arange(len(fresh))
    x, y = (np.interp(s, s[fresh], track.floats(c)[fresh]) for c in ("x", "y"))
    ends = [np.interp(s + d, s, v) for d in (-10.0, 10.0) for v in (x, y)]
    return track.with_columns(x=x, y=y, heading=np.arctan2(ends[3] - ends[1], ends[2] - ends[0]))


def profiles(d: Diagnosis, log: Log) -> list[Profile]:
    """Found and recorded slope of every run; nothing where no slope was found."""
    channel = next((c for c in d.channels.values() if "grade" in c.fields), None)
    if channel is None:
        return []
    cells, values = channel.problem.channel.cells(all_terms()["grade"]), channel.fields["grade"]
    assert isinstance(cells, Squares)
    cuts = np.flatnonzero(np.diff(log.track.time) > SILENCE * 1e6) + 1
    pieces = zip([0, *cuts], [*cuts, len(log.track)], strict=True)
    out = [
        _profile(log.track[int(a) : int(b)], log.withheld[a:b], cells, values)
        for a, b in pieces
        if b - a > 100
    ]
    return [p for p in out if p is not None and len(p.middle)]


def _profile(track: Trajectory, altitude: Floats, cells: Squares, values: Values) -> Profile | None:
    # A receiver that holds its altitude while the road goes on tells it anew when it changes.
    fresh = updates(track.seconds(), *(track.floats(c) for c in ("x", "y", "speed"))) & np.isfinite(altitude)
    rows = np.flatnonzero(fresh)
    fresh[rows[1:][np.diff(altitude[rows]) == 0.0]] = False
    if fresh.sum() < 20:
        return None
    track, driven = placed(track), travelled(track)
    s = np.arange(0.0, driven[-1], STEP)
    on = driven + 1e-6 * np.arange(len(driven))
    x, y = np.interp(s, on, track.floats("x")), np.interp(s, on, track.floats("y"))
    heading = np.interp(s, on, np.unwrap(track.floats("heading")))
    z = np.interp(s, on[fresh], altitude[fresh])
    number, _ = cells.at(Motion.of(len(x), x=x, y=y))
    way = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    known = number >= 0
    slope = np.where(known, (values.deviation.reshape(-1, 2)[number] * way).sum(axis=1), np.nan)
    pairs = values.basis.reshape(len(cells), 2, -1)
    square = pairs @ values.covariance @ pairs.transpose(0, 2, 1)
    spread = np.where(known, np.sqrt(np.einsum("ni,nij,nj->n", way, square[number], way)), np.nan)
    size = int(PIECE / STEP)
    count = (len(s) - 1) // size
    grid = slice(0, count * size)
    mean, error = (np.nanmean(v[grid].reshape(count, size), axis=1) for v in (slope, spread))
    at = np.arange(count + 1) * size
    xy = np.stack([x[at], y[at]], axis=1)
    place = np.concatenate([xy[:-1], xy[1:]], axis=1)
    return Profile(
        s, z, s[grid].reshape(count, size).mean(axis=1), mean, error, np.diff(z[at]) / PIECE, place
    )


def by_altitude(all_profiles: list[Profile]) -> dict[str, float]:
    """Agreement of the two slopes over pieces of a kilometre."""
    if not all_profiles:
        return {}
    found, true, error = (
        np.concatenate([getattr(p, n) for p in all_profiles]) for n in ("found", "recorded", "error")
    )
    return {
        "pieces": len(found),
        "correlation": float(np.corrcoef(found, true)[0, 1]),
        "found_over_recorded": float((found * true).sum() / (true * true).sum()),
        "rms_difference": float(np.sqrt(np.mean((found - true) ** 2))),
        "rms_recorded": float(np.sqrt(np.mean(true**2))),
        "in_interval": float(np.mean(np.abs(found - true) < 1.96 * error)),
    } | _repeated(all_profiles)


def _repeated(all_profiles: list[Profile]) -> dict[str, float]:
    """How well the recorded slope agrees with itself where another run covers the same piece of road the same way."""
    mine, other = [], []
    for i, p in enumerate(all_profiles):
        for q in all_profiles[:i]:
            apart = np.abs(p.place[:, None, :] - q.place[None, :, :]).max(axis=2)
            nearest = apart.argmin(axis=1)
            same = apart.min(axis=1) < NEAR
            mine.extend(p.recorded[same])
            other.extend(q.recorded[nearest[same]])
    if len(mine) < 30:
        return {}
    return {
        "recorded_twice": len(mine),
        "correlation_of_recorded_with_itself": float(np.corrcoef(mine, other)[0, 1]),
    }


def classes(d: Diagnosis, log: Log) -> list[Class]:
    """The resistance found of every trip, with the label that was withheld."""
    finding = next((f for f in d.verdict.findings if f.depends_on == ["trip_id"]), None)
    if finding is None or finding.when is None:
        return []
    trip, step = log.track.trip_ids(), np.diff(travelled(log.track), prepend=0.0)
    short = np.diff(log.track.seconds(), prepend=0.0) < 1.0
    out = []
    for name, (value, low, high) in finding.when["trips"].items():
        rows = trip == int(name)
        label = log.labels[int(np.median(log.withheld[rows]))]
        metres = float(step[rows & short].sum())
        out.append(Class(label, value, low, high, metres, finding.when["unit"]))
    return out


def by_surface(found: list[Class]) -> dict[str, object]:
    """Mean resistance of each surface, and the share of the variance between trips that the surfaces make up."""
    if not found:
        return {}
    label, value = np.array([c.label for c in found]), np.array([c.value for c in found])
    means = {str(k): float(value[label == k].mean()) for k in np.unique(label)}
    inside = sum(float(((value[label == k] - m) ** 2).sum()) for k, m in means.items())
    return {
        "trips": {str(k): int((label == k).sum()) for k in means},
        "mean": dict(sorted(means.items(), key=lambda kv: kv[1])),
        "variance_between_surfaces": 1.0 - inside / float(((value - value.mean()) ** 2).sum()),
    }
