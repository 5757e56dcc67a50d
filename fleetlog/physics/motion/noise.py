"""Noise of the smoother: measured on the innovations, not guessed.

The parameters are those under which the filter's one-step predictions fit best (maximum likelihood of the
innovations), found by a pattern search over their logarithms on a sample of rows."""

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.physics.motion.rows import Codes

SAMPLE = 12_000  # Rows on which the noise is measured, in up to six runs
PERSISTENCE = 3.0  # Of an acceleration: as long as a truck gathers speed [s]; the jerk is that of any rate
COARSE = 0.5  # Of a denser log so much is enough to see how strong the jerk is [s]
ROUNDS = 3  # To find the jerk's strength: a fourth changes no energy by a thousandth
ENCODER = 0.03  # Noise of a usual speed channel, 1 % of a truck's speed [m/s]
PATH = 1.0  # The way through a corner is known to about this, whatever the positions; speed knows better [m]
SELDOM = 2.0  # ... where its rows are closer than this [s]
NORMAL_QUARTER = 0.3186  # A quarter of normal variables are no larger than this many standard deviations
BENDS = 0.03  # A mean speed is off that of the middle of its step by so much a second of it [m/s2]
BOUNDS = {"jerk": (1e-4, 30.0), "position": (0.003, 30.0), "speed": (0.003, 2.0)}


@dataclass(frozen=True)
class Noise:
    """White jerk density [m2/s5], standard deviations of a measured ``position`` [m] and ``speed`` [m/s]."""

    jerk: float = 0.1
    position: float = 0.3
    speed: float = 0.1


class Observed(NamedTuple):
    """What the filter sees: time [s], way [m] and speed [m/s] (NaN unknown), rest, how rows follow."""

    t: Floats
    seen: Floats
    speed: Floats
    rest: Mask
    link: Codes

    def sample(self, rows: int) -> "Observed":
        """Some runs of rows, each after a break."""
        if len(self.t) <= rows:
            return self
        size = rows // 6
        starts = np.linspace(0, len(self.t) - size, 6).astype(int)
        part = self.taken((starts[:, None] + np.arange(size)).ravel())
        part.link[::size] = 2
        return part

    def at(self, moments: Floats) -> tuple["Observed", Ints]:
        """With further moments, in which nothing is seen (between rests it rests), and the index of each."""
        if np.array_equal(self.t, moments):
            return self, np.arange(len(moments))
        t, inverse = np.unique(np.append(self.t, moments), return_inverse=True)
        own = inverse[: len(self.t)]
        seen, speed, link = np.full(len(t), np.nan), np.full(len(t), np.nan), np.zeros(len(t), np.uint8)
        seen[own], speed[own], link[own] = self.seen, self.speed, self.link
        after = np.searchsorted(own, np.arange(len(t)))
        before = np.searchsorted(own, np.arange(len(t)), side="right") - 1
        return Observed(t, seen, speed, self.rest[after] & self.rest[before], link), inverse[len(self.t) :]

    def with_mean_speed(self) -> "Observed":
        """Of rows whose speed is the mean since the row before: it is that of the middle of the step."""
        joined = np.flatnonzero(self.link[1:] != 2) + 1
        kept = self._replace(speed=np.where(self.link == 2, self.speed, np.nan))
        out, middle = kept.at(0.5 * (self.t[joined] + self.t[joined - 1]))
        out.speed[middle] = self.speed[joined]
        return out

    def taken(self, rows: NDArray[np.intp]) -> "Observed":
        """Some of the rows."""
        return Observed._make(values[rows] for values in self)


def estimate_noise(observed: Observed, start: Noise, mean_over: float = 0.0) -> Noise:
    """The likeliest noise, from ``start``, which stays where nothing is seen; ``mean_over`` of speeds [s]."""
    sample = observed.sample(SAMPLE)
    names = ["jerk"]
    if np.isfinite(sample.seen).sum() > 20:
        names.append("position")
    if (np.isfinite(sample.speed).sum() <= 20 and len(names) == 1) or len(sample.t) < 20:
        return start
    # Trucks gather and shed speed at nearly constant rates, with sharp bends between; a Gaussian jerk
    # cannot follow these: they would pass for noise of the speed, which shows in its third differences.
    noise, bounds = replace(start, speed=max(speed_noise(sample), BENDS * mean_over)), BOUNDS
    if np.isfinite(sample.speed).mean() > 0.9 and np.median(np.diff(sample.t)) < SELDOM:
        noise, bounds = replace(noise, position=PATH), {**BOUNDS, "position": (PATH, BOUNDS["position"][1])}

    def stepped(name: str, factor: float) -> Noise:
        return replace(noise, **{name: float(np.clip(getattr(noise, name) * factor, *bounds[name]))})

    def likelihood(of: Noise) -> float:
        return _filtered(sample, of, np.full(len(sample.t), of.jerk), 0)[0]

    best = likelihood(noise)
    for factor in (8.0, 3.0, 1.7, 1.3):
        for _ in range(4):
            before = best
            for name, step in product(names, (factor, 1.0 / factor)):
                while (trial := stepped(name, step)) != noise:
                    if not (new := likelihood(trial)) > best:
                        break
                    best, noise = new, trial
            if best <= before + 1e-6:
                break
    return noise


def speed_noise(o: Observed) -> float:
    """Standard deviation of the speed channel [m/s] from the quieter third differences of driven rows. Where
    a truck begins to brake or to gather speed they show that; a quarter of the rows lies between. Where rows
    are so far apart that the speed itself bends between them, that of a usual wheel encoder."""
    third = o.speed[3:] - 3.0 * o.speed[2:-1] + 3.0 * o.speed[1:-2] - o.speed[:-3]
    lowest = np.min([o.speed[k : len(o.speed) - 3 + k] for k in range(4)], axis=0)
    whole = (o.t[3:] - o.t[:-3] < 4.5) & np.isfinite(third) & (lowest > 0.3)
    if whole.sum() < 50:
        return ENCODER
    usual = np.quantile(np.abs(third[whole]), 0.25) / NORMAL_QUARTER
    return float(np.clip(usual / np.sqrt(20.0), *BOUNDS["speed"]))


def _filtered(o: Observed, noise: Noise, jerk: Floats, room: int) -> tuple[float, Floats, Floats]:
    """The logarithm of the likelihood; means and covariances of the filter's states if there is room."""
    from fleetlog.physics.motion.kernels.filter import filter_forward

    mean, cov = np.empty((room, 3)), np.empty((room, 6))
    likelihood = filter_forward(
        o.t, o.seen, noise.position**2, o.speed, noise.speed**2, o.rest, o.link, jerk, 1.0 / PERSISTENCE,
        mean, cov,
    )  # fmt: skip
    return likelihood, mean, cov


class Smoothed(NamedTuple):
    """The states at N moments."""

    mean: Floats  # (N, 3) way, speed, acceleration
    cov: Floats  # (N, 6) ss, sv, sa, vv, va, aa
    gain: NDArray[np.float32]  # (N, 9)


def smooth(o: Observed, noise: Noise, jerk: Floats) -> Smoothed:
    """The smoothed states, and the gains of the backward pass, which tie the states of different times."""
    from fleetlog.physics.motion.kernels.filter import smooth_backward

    _, mean, cov = _filtered(o, noise, jerk, len(o.t))
    gain = np.zeros((len(o.t), 9), np.float32)
    smooth_backward(o.t, o.link, jerk, 1.0 / PERSISTENCE, mean, cov, gain)
    return Smoothed(mean, cov, gain)


def jerk_strength(o: Observed, noise: Noise) -> Floats:
    """(N,) density [m2/s5] of the jerk in the step to a row, the same for all where rows are seconds apart;
    little in a cruise, much where a truck begins to brake."""
    from fleetlog.physics.motion.kernels.filter import jerk_scales

    if len(o.t) < 2 or np.median(np.diff(o.t)) > SELDOM + COARSE:
        return np.full(len(o.t), noise.jerk)
    slot = np.floor(o.t / COARSE + 1e-6)
    few = np.flatnonzero((np.diff(slot, prepend=-1.0) > 0) | np.isfinite(o.seen) | (o.link != 0))
    c = o.taken(few)
    scale, jerk = noise.jerk, np.full(len(few), noise.jerk)
    for _ in range(ROUNDS):
        s = smooth(c, noise, jerk)
        scale = jerk_scales(c.t, c.link, c.rest, scale, 1.0 / PERSISTENCE, s.mean, s.cov, s.gain, jerk)
    return jerk[np.minimum(np.searchsorted(few, np.arange(len(o.t))), len(few) - 1)]
