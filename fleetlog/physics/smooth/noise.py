"""Noise of the smoother: measured on the innovations, not guessed.

The parameters are those under which the filter's one-step predictions fit best (maximum likelihood of the innovations), found by
a pattern search over their logarithms on a sample of rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SAMPLE = 12_000
"""Rows on which the noise is measured, in up to six runs."""
BOUNDS = {"jerk": (1e-4, 30.0), "position": (0.003, 30.0), "speed": (0.003, 2.0)}


@dataclass(frozen=True)
class Noise:
    """White jerk density ``jerk`` [m2/s5]; standard deviations of a measured ``position`` [m] and ``speed`` [m/s]."""

    jerk: float = 0.05
    position: float = 0.3
    speed: float = 0.1


@dataclass(frozen=True)
class Observed:
    """What the filter sees: seconds, path coordinate [m] and speed [m/s] (NaN unknown), rest, and how rows follow."""

    t: Floats
    seen: Floats
    speed: Floats
    rest: NDArray[np.bool_]
    link: NDArray[np.uint8]

    def sample(self, rows: int) -> Observed:
        """Some runs of rows, each after a break."""
        n = len(self.t)
        if n <= rows:
            return self
        runs = 6
        starts = np.linspace(0, n - rows // runs, runs).astype(int)
        index = np.concatenate([np.arange(s, s + rows // runs) for s in starts])
        link = self.link[index].copy()
        link[:: rows // runs] = 2
        return Observed(self.t[index], self.seen[index], self.speed[index], self.rest[index], link)


def estimate_noise(observed: Observed, start: Noise) -> Noise:
    """The likeliest noise, from ``start``; what is not observed keeps its start value."""
    sample = observed.sample(SAMPLE)
    names = ["jerk"]
    if np.isfinite(sample.seen).sum() > 20:
        names.append("position")
    if np.isfinite(sample.speed).sum() > 20:
        names.append("speed")
    if len(names) == 1 or len(sample.t) < 20:
        return start
    # Trucks gather and shed speed at nearly constant rates, with sharp bends between; a Gaussian jerk cannot follow these and
    # the likelihood would put them down to the speed channel, whose noise shows in its third differences.
    noise = start
    shown = speed_noise(sample)
    if "speed" in names and shown is not None:
        names.remove("speed")
        noise = replace(start, speed=shown)
    best = _likelihood(sample, noise)
    for factor in (8.0, 3.0, 1.7, 1.3):
        for _ in range(4):
            before = best
            for name in names:
                best, noise = _line(sample, noise, name, factor, best)
            if best <= before + 1e-6:
                break
    return noise


def speed_noise(o: Observed) -> float | None:
    """Standard deviation of the speed channel [m/s] from third differences of driven rows (robust); None where few are there.

    An upper bound: where rows are so far apart that the speed itself changes in bends between them, the likelihood decides.
    """
    third = o.speed[3:] - 3.0 * o.speed[2:-1] + 3.0 * o.speed[1:-2] - o.speed[:-3]
    whole = (
        (o.t[3:] - o.t[:-3] < 4.5)
        & np.isfinite(third)
        & (np.min([o.speed[k : len(o.speed) - 3 + k] for k in range(4)], axis=0) > 0.3)
    )
    if whole.sum() < 50:
        return None
    return float(np.clip(1.4826 * np.median(np.abs(third[whole])) / np.sqrt(20.0), *BOUNDS["speed"]))


def _line(sample: Observed, noise: Noise, name: str, factor: float, best: float) -> tuple[float, Noise]:
    for step in (factor, 1.0 / factor):
        while True:
            value = float(np.clip(getattr(noise, name) * step, *BOUNDS[name]))
            trial = replace(noise, **{name: value})
            likelihood = _likelihood(sample, trial)
            if value == getattr(noise, name) or not likelihood > best:
                break
            best, noise = likelihood, trial
    return best, noise


def _likelihood(o: Observed, noise: Noise) -> float:
    from fleetlog.physics.smooth.kernels import filter_forward

    none3, none6 = np.empty((0, 3)), np.empty((0, 6))
    return float(
        filter_forward(
            o.t, o.seen, noise.position**2, o.speed, noise.speed**2, o.rest, o.link, noise.jerk, none3, none6
        )
    )


def smooth(o: Observed, noise: Noise) -> tuple[Floats, Floats]:
    """Smoothed means (N, 3: coordinate, speed, acceleration) and covariances (N, 6)."""
    from fleetlog.physics.smooth.kernels import filter_forward, smooth_backward

    mean, cov = np.empty((len(o.t), 3)), np.empty((len(o.t), 6))
    filter_forward(
        o.t, o.seen, noise.position**2, o.speed, noise.speed**2, o.rest, o.link, noise.jerk, mean, cov
    )
    smooth_backward(o.t, o.link, noise.jerk, mean, cov)
    return mean, cov
