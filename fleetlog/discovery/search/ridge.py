"""The regression: the likeliest step of each coefficient under prior and bounds, from sums of squares and
products of the columns over windows, fold by fold.

These add up: those of two days are the sum of those of each.  Memory grows with the columns, not the rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.hypotheses.sources import Layout

ROUNDING = 1e-9  # Of a step: what solving is not told from
SINGLE = 1e-6  # Of a column's square: what its products, summed in single precision, are not known to
PATIENCE = 3  # Changes of all at once that may fail to help; the result is the same for any number
ENOUGH = 4096  # Windows that are multiplied at once
Columns = NDArray[np.float32]


@dataclass(frozen=True)
class Prior:
    """(k,) of each coefficient's step: its normal prior's ``precision`` and ``centre``, its bounds."""

    precision: Floats
    centre: Floats
    low: Floats
    high: Floats

    def part(self, which: NDArray[np.intp] | Mask) -> Prior:
        """Return that of some coefficients."""
        return Prior(self.precision[which], self.centre[which], self.low[which], self.high[which])

    def within(self, beta: Floats) -> Mask:
        """Return which coefficients stand on no bound."""
        return np.asarray((beta > self.low) & (beta < self.high))

    def penalty(self, beta: Floats) -> float:
        """Return half the sum of squared standard deviations from the centre."""
        return float(0.5 * np.sum(self.precision * (beta - self.centre) ** 2))


@dataclass
class Sums:
    """Products of P columns and the residual (the last column), weighted. ``fold`` (F, P+1, P+1) by fold of
    trips; ``slow`` (F, p+1, p+1) by fold of stretches of hours, of the columns without cells and the
    residual; ``own`` (V, F, n, P+1) those of numbers, by vehicle."""

    layout: Layout
    fold: Floats
    slow: Floats
    own: Floats
    energy: float = 0.0  # Weighted square of the recorded quantity, over all windows
    _waiting: list[tuple[NDArray[Any], ...]] = field(default_factory=list)

    @classmethod
    def empty(cls, layout: Layout, folds: int, vehicles: int) -> Sums:
        """Return sums of nothing."""
        p, q = layout.width + 1, layout.core + 1
        own = np.zeros((vehicles if vehicles > 1 else 0, folds, layout.numbers, p))
        return cls(layout, np.zeros((folds, p, p)), np.zeros((folds, q, q)), own)

    def __add__(self, other: Sums) -> Sums:
        """Return those of both."""
        own = (getattr(self, n) + getattr(other, n) for n in ("fold", "slow", "own", "energy"))
        return Sums(self.layout, *own)

    def add(self, x: Columns, residual: Floats, recorded: Floats, weight: Floats, *codes: Ints) -> None:
        """Add windows: (W, P) columns, residual, recorded quantity, inverse variance; folds and vehicle."""
        root = np.sqrt(weight).astype(np.float32)[:, None]
        z = np.concatenate([x, residual.astype(np.float32)[:, None]], axis=1) * root
        self._waiting.append((z, *codes))
        self.energy += float(weight @ recorded**2)
        if sum(len(w[0]) for w in self._waiting) >= ENOUGH:
            self.flush()

    def flush(self) -> None:
        """Multiply what is waiting."""
        if not self._waiting:
            return
        z, fold, slow, vehicle = (np.concatenate(column) for column in zip(*self._waiting, strict=True))
        self._waiting.clear()
        for k in np.unique(fold):
            part = z[fold == k]
            self.fold[k] += part.T @ part
            for v in np.unique(vehicle[fold == k]) if len(self.own) else ():
                mine = part[vehicle[fold == k] == v]
                self.own[v, k] += mine[:, : self.layout.numbers].T @ mine
        few = np.concatenate([z[:, : self.layout.core], z[:, -1:]], axis=1)
        for k in np.unique(slow):
            part = few[slow == k]
            self.slow[k] += part.T @ part


@dataclass(frozen=True)
class Normal:
    """(F, k, k) products of the columns, (F, k) with the residual, (F,) of the residual, by fold."""

    gram: Floats
    moment: Floats
    square: Floats


def stiff(gram: Floats, prior: Prior) -> Floats:
    """Return (k, k) products with the precision of a prior; what nothing speaks for gets a trace of one."""
    out = np.array(gram, dtype=np.float64)
    diagonal = np.einsum("ii->i", out)
    diagonal += prior.precision + 1e-9 * np.maximum(diagonal, 1e-12)
    return out


def inverse(stiffened: Floats) -> Floats:
    """Return the inverse of (k, k) products; of those that rounding leaves not positive the general one."""
    root, failed = lapack.dpotrf(stiffened) if len(stiffened) else (stiffened, True)
    if failed:
        return np.asarray(np.linalg.inv(stiffened))
    upper = np.triu(lapack.dpotri(root)[0])
    return np.asarray(upper + np.triu(upper, 1).T)


def solve(gram: Floats, moment: Floats, prior: Prior, near: Floats | None = None) -> Floats:
    """Return the (k,) most probable steps, a strictly convex problem. By block principal pivoting (Judice and
    Pires 1994): all coefficients that break a condition change sides together; where that does not lessen
    their number, only the last one does, and then no set comes twice. It begins with those on a bound that
    are so of a solution ``near``."""
    h = stiff(gram, prior)
    b = moment + prior.precision * prior.centre
    near = np.zeros(len(b)) if near is None else near
    held = ((near >= prior.high).astype(np.int8) - (near <= prior.low)).astype(np.int8)
    fewest, patience, singly = len(b) + 1, PATIENCE, set[bytes]()
    while True:
        free = held == 0
        beta = np.where(held < 0, prior.low, np.where(held > 0, prior.high, 0.0))
        if free.any():
            products, right = h[np.ix_(free, free)], b[free] - h[np.ix_(free, ~free)] @ beta[~free]
            _, found, failed = lapack.dposv(products, right)
            beta[free] = np.linalg.solve(products, right) if failed else found
        slope = h @ beta - b
        new = np.where(free & (beta < prior.low), -1, np.where(free & (beta > prior.high), 1, held))
        new = np.where(held * slope > ROUNDING * np.diag(h), 0, new).astype(np.int8)
        if not len(broken := np.flatnonzero(new != held)):
            return np.clip(beta, prior.low, prior.high)
        if len(broken) < fewest:
            fewest, patience, singly = len(broken), PATIENCE, set()
        elif (patience := patience - 1) < 0:
            if held.tobytes() in singly:
                # Columns say the same but for their rounding, so that products are not positive.
                return solve(gram + np.diag(SINGLE * np.diag(gram)), moment, prior, near)
            singly.add(held.tobytes())
        moved = broken if patience >= 0 else broken[-1:]
        held[moved] = new[moved]


@dataclass(frozen=True)
class Fitted:
    """``beta`` (k,) on all folds; ``losses`` (F,) of each by the fit without it; the prior's ``penalty``."""

    beta: Floats
    losses: Floats
    penalty: float


def cross_validated(n: Normal, prior: Prior) -> Fitted:
    """Fit on all folds, and on all but each."""
    gram, moment = n.gram.sum(axis=0), n.moment.sum(axis=0)
    beta = solve(gram, moment, prior)
    losses = []
    for g, m, square in zip(n.gram, n.moment, n.square, strict=True):
        unseen = solve(gram - g, moment - m, prior, beta)
        losses.append(square - 2.0 * unseen @ m + unseen @ g @ unseen)
    return Fitted(beta, np.array(losses), prior.penalty(beta))
