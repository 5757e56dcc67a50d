"""Ridge regression on Gram matrices, with honest errors held in boxes.

One pass over the windows builds X'X and X'y per fold; folds add up, and so do days.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.unseen import Shared, amount, shared
from fleetlog.discovery.windows import Windows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Sums = tuple[NDArray[np.float32], Floats, float, int]
"""X'X, X'y, y'y and number of some windows: all that a fit needs of them, and they add up over folds, trips and days."""

Hold = tuple[str, Callable[[Floats], Floats]]
"""A group, and what its coefficients are held to once they are known."""

BOX = 2.0
"""Nuisances stay within this many standard deviations."""
JITTERY = 3.0
"""Windows that jump this many times more than usual weigh less."""
FREE = 0.02
"""Ridge of the freest model, as a share of each column's own square."""
PLENTY = 10
"""Windows for each column, from which on a window hardly bends its own fit."""
LEVER = 0.005
"""Least share of a window's residual that its own fit leaves: rounding decides below."""
CHUNK = 8192
"""Windows that are weighted at a time."""
HUBER = 4.0
"""Residuals beyond this many standard deviations weigh less."""


@dataclass
class Problem:
    """Weighted windows: ``x`` (W, P) all columns, ``y`` (W,), both times the root of the weight; ``at`` columns by group.

    ``fold`` (W,) numbers the folds of each kind of split; ``trip`` and ``block`` (W,) number the independent samples of
    fast and of slow variables.
    """

    x: NDArray[np.float32]
    y: Floats
    weight: Floats
    at: dict[str, Ints]
    nuisance: Ints
    spread: Floats
    own: NDArray[np.bool_]
    trip: Ints
    block: Ints
    fold: dict[str, Ints]
    rows: NDArray[np.bool_]
    common: Shared | None = None
    inner: Problem | None = None
    """The problem that this one has some more columns than: its sums are not added up again."""
    _by_fold: dict[str, list[Sums]] = field(default_factory=dict)

    @cached_property
    def gram(self) -> Floats:
        """(P, P) X'X, the sum over the folds of trips."""
        total = np.zeros((self.x.shape[1], self.x.shape[1]))
        for gram, *_ in self.folds("trip"):
            total += gram
        return total

    @cached_property
    def moment(self) -> Floats:
        """(P,) X'y."""
        return np.asarray(np.sum([f[1] for f in self.folds("trip")], axis=0))

    def folds(self, kind: str) -> list[Sums]:
        """The sums of every fold of a kind of split."""
        if kind not in self._by_fold:
            before = None if self.inner is None else self.inner.folds(kind)
            of = self.fold[kind]
            self._by_fold[kind] = [
                self._sums(of == k, None if before is None else before[k]) for k in range(int(of.max()) + 1)
            ]
        return self._by_fold[kind]

    def _sums(self, rows: NDArray[np.bool_], before: Sums | None) -> Sums:
        """The sums of some windows; ``before`` those of the columns that came first."""
        x, y = self.x[rows], self.y[rows]
        begin = 0 if before is None else len(before[1])
        new = x[:, begin:]
        border = x.T @ new if begin else x.T @ x
        moment = (new.T @ y.astype(np.float32)).astype(float)
        if before is None:
            return border, moment, float(y @ y), len(y)
        gram = np.empty((x.shape[1], x.shape[1]), np.float32)
        gram[:begin, :begin] = before[0]
        gram[:, begin:], gram[begin:] = border, border.T
        return gram, np.concatenate([before[1], moment]), before[2], before[3]

    def scaled(self, values: Floats) -> Floats:
        """Values of all windows, (W,) or (W, k), as rows of this problem: picked out, weighted, made independent."""
        root = np.sqrt(self.weight[self.rows])
        out = values[self.rows] * (root if values.ndim == 1 else root[:, None])
        return out if self.common is None else self.common.out_of(out)

    def predicted(self, columns: Ints, beta: Floats) -> Floats:
        """(W,) what coefficients of some columns make; one product with all is faster than picking columns out."""
        every = np.zeros(self.x.shape[1], np.float32)
        every[columns] = beta
        return (self.x @ every).astype(float)

    def extended(self, columns: dict[str, NDArray[np.float32]]) -> Problem:
        """With more groups, (W, k) each."""
        at, begin = dict(self.at), self.x.shape[1]
        for name, c in columns.items():
            at[name] = np.arange(begin, begin + c.shape[1])
            begin += c.shape[1]
        new = self.scaled(np.concatenate([*columns.values()], axis=1)).astype(np.float32)
        return replace(self, x=np.concatenate([self.x, new], axis=1), at=at, inner=self, _by_fold={})


@dataclass(frozen=True)
class Selection:
    """Groups in the model: the columns used of each, and the prior variance of their coefficients."""

    columns: dict[str, Ints] = field(default_factory=dict)
    tau: dict[str, float] = field(default_factory=dict)
    drop: frozenset[int] = frozenset()

    def add(self, name: str, columns: Ints, tau: float, drop: frozenset[int] = frozenset()) -> Selection:
        """With one more group; ``drop`` nuisance columns that it makes needless."""
        return Selection({**self.columns, name: columns}, {**self.tau, name: tau}, self.drop | drop)

    def remove(self, name: str) -> Selection:
        """With one group less."""
        rest = {k: v for k, v in self.columns.items() if k != name}
        return Selection(rest, {k: self.tau[k] for k in rest}, self.drop)


@dataclass(frozen=True)
class Fit:
    """Coefficients ``beta`` of ``columns``; ``inverse`` the posterior covariance over the noise variance; ``nuisances`` come first."""

    columns: Ints
    beta: Floats
    inverse: Floats
    nuisances: int

    def part(self, selection: Selection, name: str) -> slice:
        """Where the coefficients of a group are."""
        begin = self.nuisances
        for k, c in selection.columns.items():
            if k == name:
                return slice(begin, begin + len(c))
            begin += len(c)
        raise KeyError(name)

    def of(self, selection: Selection, name: str) -> tuple[Floats, Floats]:
        """Coefficients of a group and their covariance block."""
        part = self.part(selection, name)
        return self.beta[part], self.inverse[part, part]


def fit(
    p: Problem,
    s: Selection,
    without: Sums | None = None,
    *,
    moment: Floats | None = None,
    inverse: bool = True,
    hold: Hold | None = None,
) -> Fit:
    """Ridge fit of nuisances and selected groups; nuisances at the wall of their box stay there.

    ``without`` are the sums of windows to leave out; ``moment`` (P,) takes the place of X'y.  Coefficients under ``hold``
    are replaced, and the others follow.
    """
    keep = np.array([j not in s.drop for j in p.nuisance], dtype=bool)
    spread = p.spread[keep]
    c = np.concatenate([p.nuisance[keep], *s.columns.values()]).astype(int)
    n = int(keep.sum())
    penalty = np.concatenate(
        [1.0 / spread**2, *(np.full(len(v), 1.0 / s.tau[k]) for k, v in s.columns.items())]
    )
    h, b = p.gram[np.ix_(c, c)], (p.moment if moment is None else moment)[c]
    if without is not None:
        h, b = h - without[0][np.ix_(c, c)], b - without[1][c]
    h = h + np.diag(penalty)
    beta = np.linalg.solve(h, b)
    wall = np.concatenate([BOX * spread, np.full(len(c) - n, np.inf)])
    stuck, fixed = np.zeros(len(c), bool), np.zeros(len(c))
    if hold is not None:
        part = Fit(c, beta, h, n).part(s, hold[0])
        stuck[part], fixed[part] = True, hold[1](beta[part])
        beta = _others(h, b, stuck, fixed)
    for _ in range(4):
        out = ~stuck & (np.abs(beta) > wall * (1.0 + 1e-9))
        if not out.any():
            break
        stuck |= out
        fixed = np.where(out, np.clip(beta, -wall, wall), fixed)
        beta = _others(h, b, stuck, fixed)
    if not inverse:
        return Fit(c, beta, np.zeros((0, 0)), n)
    spread_of = np.zeros_like(h)
    free = ~stuck
    spread_of[np.ix_(free, free)] = np.linalg.inv(h[np.ix_(free, free)])
    return Fit(c, beta, spread_of, n)


def _others(h: Floats, b: Floats, stuck: NDArray[np.bool_], fixed: Floats) -> Floats:
    """The solution with some coefficients fixed."""
    free = ~stuck
    beta = np.where(stuck, fixed, 0.0)
    beta[free] = np.linalg.solve(h[np.ix_(free, free)], b[free] - h[np.ix_(free, stuck)] @ fixed[stuck])
    return beta


def refit_tau(p: Problem, s: Selection, rounds: int = 4) -> Selection:
    """Prior variances at their empirical-Bayes fixed point (MacKay's rule)."""
    for _ in range(rounds if s.columns else 0):
        f = fit(p, s)
        tau = {}
        for name, c in s.columns.items():
            beta, inverse = f.of(s, name)
            tau[name] = float(np.clip((beta @ beta + np.trace(inverse)) / len(c), 1e-12, 1e12))
        s = Selection(s.columns, tau, s.drop)
    return s


def loss(f: Fit, fold: Sums) -> float:
    """Mean squared weighted residual of a fit on a fold."""
    gram, moment, yy, n = fold
    value = yy - 2.0 * f.beta @ moment[f.columns] + f.beta @ gram[np.ix_(f.columns, f.columns)] @ f.beta
    return float(value) / max(n, 1)


def noise_weights(
    windows: Windows, model: Floats, residual: Floats, use: NDArray[np.bool_], jitter: Floats, crude: Floats
) -> Floats:
    """(W,) inverse variance of the residual: robust, in twelve classes of power, as noise grows with the power drawn.

    ``crude`` is what the model itself may be off by, ``jitter`` how much power jumps from row to row.
    """
    level = np.abs(model) / np.maximum(windows.duration, 1e-6)
    edges = np.quantile(level[use], np.linspace(0.0, 1.0, 13))
    bin_ = np.clip(np.searchsorted(edges, level) - 1, 0, 11)
    rate = residual**2 / np.maximum(windows.duration, 1e-6)
    known = [k for k in range(12) if (use & (bin_ == k)).sum() >= 5]
    spread = np.array([np.median(rate[use & (bin_ == k)]) * 2.2 for k in known])
    centre = np.array([level[use & (bin_ == k)].mean() for k in known])
    spread = np.maximum(spread, 0.1 * np.median(spread) + 1e-12)
    weight = 1.0 / (np.interp(level, centre, spread) * np.maximum(windows.duration, 1e-6))
    # Where power jumps between rows far more than usual, motion is faster than the log resolves and says little.
    usual = np.median(jitter[use & windows.moving]) if (use & windows.moving).any() else 0.0
    weight = 1.0 / (1.0 / weight + crude**2)
    return np.asarray(
        weight / np.maximum(1.0, (jitter / max(JITTERY * usual, 1e-9)) ** 4 if usual > 0 else 1.0)
    )


def pose(
    windows: Windows,
    model: Floats,
    y: Floats,
    groups: dict[str, NDArray[np.float32]],
    nuisance: dict[str, NDArray[np.float32]],
    spread: dict[str, Floats],
    use: NDArray[np.bool_],
    fold: dict[str, Ints],
    block: Ints,
    jitter: Floats,
    crude: Floats,
    weight: Floats | None = None,
    load: Floats | None = None,
) -> Problem:
    """The problem of the windows in ``use``, with weights from what the freest model leaves (or given).

    ``load`` (W,) is what one standard deviation of an unknown load adds, the same load in all windows of a trip.
    """
    names = [*nuisance, *groups]
    width = [*(v.shape[1] for v in nuisance.values()), *(v.shape[1] for v in groups.values())]
    ends = np.cumsum(width)
    x = np.empty((int(use.sum()), int(ends[-1])), np.float32)
    for v, end, wide in zip([*nuisance.values(), *groups.values()], ends, width, strict=True):
        x[:, end - wide : end] = v[use]
    at = {
        f"nuisance {n}" if i < len(nuisance) else n: np.arange(e - w, e)
        for i, (n, w, e) in enumerate(zip(names, width, ends, strict=True))
    }
    index = np.arange(sum(width[: len(nuisance)]))
    spreads = np.concatenate([spread[n] for n in nuisance])
    own = np.concatenate([np.full(v.shape[1], n.startswith("vehicle")) for n, v in nuisance.items()])
    if weight is None:
        weight = _robust_weights(windows, model, y, x, use, jitter, crude, load)
    root = np.sqrt(weight[use])
    x *= root[:, None].astype(np.float32)
    _, trip = np.unique(windows.trip[use], return_inverse=True)
    target, common = y[use] * root, None
    if load is not None:
        common = shared(load[use] * root, trip)
        x, target = common.out_of(x).astype(np.float32), common.out_of(target)
    _, slow = np.unique(block[use], return_inverse=True)
    return Problem(
        x, target, weight, at, index, spreads, own,
        trip, slow, {k: np.unique(v[use], return_inverse=True)[1] for k, v in fold.items()}, use, common,
    )  # fmt: skip


def _robust_weights(
    windows: Windows,
    model: Floats,
    y: Floats,
    x: NDArray[np.float32],
    use: NDArray[np.bool_],
    jitter: Floats,
    crude: Floats,
    load: Floats | None = None,
) -> Floats:
    """Weights from what the freest model leaves: an effect that is yet to be found must not pass for noise."""
    weight = noise_weights(windows, model, y, use, jitter, crude)
    for _ in range(2):
        h, b = _sums(x, y[use], np.sqrt(weight[use]))
        h += np.diag(FREE * np.diag(h) + 1e-9)
        beta = np.linalg.solve(h, b)
        residual = y.copy()
        residual[use] -= x @ beta.astype(np.float32)
        if load is not None:
            trip = np.unique(windows.trip, return_inverse=True)[1]
            residual -= amount(load, residual, weight * use, trip)
        if len(x) < PLENTY * x.shape[1]:
            # What a window would miss had it not been fitted itself: many columns for few windows leave no noise to see.
            lever = _leverage(x, np.sqrt(weight[use]), np.linalg.inv(h).astype(np.float32))
            residual[use] /= np.maximum(1.0 - lever, LEVER)
        weight = noise_weights(windows, model, residual, use, jitter, crude)
        z = np.abs(residual) * np.sqrt(weight)
        weight = weight * np.minimum(1.0, HUBER / np.maximum(z, 1e-9))
    return np.asarray(weight)


def _sums(x: NDArray[np.float32], y: Floats, root: Floats) -> tuple[Floats, Floats]:
    """X'X and X'y of rows multiplied by ``root`` (W,), some thousand rows at a time: no weighted copy of everything."""
    gram, moment = np.zeros((x.shape[1], x.shape[1])), np.zeros(x.shape[1])
    for begin in range(0, len(x), CHUNK):
        part = slice(begin, begin + CHUNK)
        z = x[part] * root[part, None].astype(np.float32)
        gram += z.T @ z
        moment += z.T @ (y[part] * root[part]).astype(np.float32)
    return gram, moment


def _leverage(x: NDArray[np.float32], root: Floats, inverse: NDArray[np.float32]) -> Floats:
    """(W,) how much of its own recorded value each row's fitted value is."""
    out = np.empty(len(x))
    for begin in range(0, len(x), CHUNK):
        part = slice(begin, begin + CHUNK)
        z = x[part] * root[part, None].astype(np.float32)
        out[part] = np.einsum("ij,ij->i", z @ inverse, z)
    return out
