"""What a log without payload or fork height hides: lifting at standstill, and a load that differs from trip to trip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.evaluate import Evaluation
from fleetlog.discovery.replay import Block
from fleetlog.discovery.windows import Windows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

STANDS = 0.9
"""Share of a window from which on it is a standstill."""
FEWEST = 20
"""Standstills that are needed to tell."""
USUAL = 0.25
"""Quantile of the power at standstill that is the usual one: lifting only adds."""
LIFTS = 1000.0
"""Power above the usual at standstill that shows hydraulics at work [W]."""
OFTEN = 0.05
"""Share of the standstills that must show it."""
PASSING = 0.15
"""Share of a window that may be standstill where lifting is unseen."""
PART = 0.3
"""Standard deviation of an unknown load, as a share of the empty truck at most, and half of what it may lift."""
COLUMNS = 64


def quiet(blocks: list[Block], of_row: list[Ints], w: Windows, energy: Floats) -> Mask | None:
    """(W,) windows without hydraulics at work; None where they can be replayed, or never show.

    Without a fork height they show as jumps of power at standstill.  Then only windows with hardly any standstill are quiet, and
    standstills whose power is the usual one.
    """
    if any(b.motion.fork_height.any() for b in blocks):
        return None
    stood = np.concatenate([
        np.bincount(o, b.rows((b.motion.speed <= 0.0).astype(float)) * b.rows(b.motion.dt) * b.steps)
        for b, o in zip(blocks, of_row, strict=True)
    ])  # fmt: skip
    share = stood / np.maximum(w.duration, 1e-6)
    known = (share > STANDS) & np.isfinite(energy)
    if known.sum() < FEWEST:
        return None
    rate = 1e3 * np.nan_to_num(energy) / np.maximum(w.duration, 1e-6)
    usual = np.quantile(rate[known], USUAL)
    if np.mean(np.abs(rate[known] - usual) > LIFTS) < OFTEN:
        return None
    return np.asarray((share < PASSING) | (known & (np.abs(rate - usual) < LIFTS / 4.0)))


def carries(blocks: list[Block], lifting: bool) -> bool:
    """Whether the trucks carry loads that nobody recorded: no payload, yet masts that work."""
    if any(b.motion.payload.any() for b in blocks):
        return False
    return lifting or any(np.ptp(b.motion.fork_height) > 0.5 for b in blocks)


@dataclass(frozen=True)
class Shared:
    """A random amount of something that all windows of a trip share, taken out of weighted rows.

    With rows r of covariance 1 + z z' within a trip (z what a standard deviation of the amount adds), multiplying by
    1 - c u u', u = z / |z|, c = 1 - 1 / sqrt(1 + |z|^2) makes them independent again.  ``unit`` (n,), ``shrink`` (n,) are u
    and c of each row's trip; ``order`` and ``begin`` sort the rows by trip.
    """

    unit: Floats
    shrink: Floats
    trip: Ints
    order: Ints
    begin: Ints

    def out_of(self, rows: NDArray[np.float32] | Floats) -> Floats:
        """(n,) or (n, k) rows made independent."""
        wide = rows.reshape(len(rows), -1)
        out = np.empty(wide.shape, wide.dtype)
        for k in range(0, wide.shape[1], COLUMNS):
            part = wide[:, k : k + COLUMNS]
            along = np.add.reduceat((part * self.unit[:, None])[self.order], self.begin, axis=0)
            out[:, k : k + COLUMNS] = part - (self.shrink * self.unit)[:, None] * along[self.trip]
        return out.reshape(rows.shape)


def shared(z: Floats, trip: Ints) -> Shared:
    """``z`` (n,) weighted, ``trip`` (n,) codes 0, 1, ..."""
    square = np.bincount(trip, z**2)
    norm = np.sqrt(np.maximum(square, 1e-300))
    order = np.argsort(trip, kind="stable")
    begin = np.searchsorted(trip[order], np.arange(len(square)))
    return Shared(z / norm[trip], (1.0 - 1.0 / np.sqrt(1.0 + square))[trip], trip, order, begin)


def amount(z: Floats, residual: Floats, weight: Floats, trip: Ints) -> Floats:
    """(W,) the best guess of what the shared amount of each trip adds to its windows."""
    top, square = np.bincount(trip, z * residual * weight), np.bincount(trip, z**2 * weight)
    return np.asarray(z * (top / (1.0 + square))[trip])


def between_rows(e: Evaluation) -> dict[str, Floats]:
    """Each (N,) W: where a truck may have slowed down and gathered speed again between two rows, unseen."""
    m = e.motion
    weight = e.mass * 9.81 * m.speed
    moving = m.speed > 0.0
    return {
        "unseen turns": weight * np.abs(m.curvature),
        "unseen stops": e.mass * m.speed * np.abs(m.acceleration),
        "unseen lifts": (m.payload + e.truck.lift.carriage_mass) * 9.81 * np.maximum(m.lift_speed, 0.0),
        "unseen moves": weight * e.truck.resistance.rolling,
        "unseen pace": e.mass * m.speed**2 * moving / 25.0,
    }
