"""What other trucks cost: the time on stretches where one was in the way, over what the same stretches take
otherwise."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from fleetlog.discovery.channels.paths import Path
from fleetlog.discovery.hypotheses.stretches import Stretches

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

OWN = 60.0
"""Undisturbed driving after which a stretch of lane is known by itself, and no longer by all others [s]."""
MODEL = 0.01  # Share of the time by which the free drive may be off on all stretches alike


@dataclass(frozen=True)
class Lost:
    """Time lost to other trucks.

    ``share`` of the travel time and its standard ``error``; ``touched`` the share of the time with another
    truck in the way; (C,) by stretch of lane: seconds ``lost`` with their ``spread``, ``time`` spent there
    [s] and ``passages``; ``p_value`` that as much is lost by chance.
    """

    share: float
    error: float
    touched: float
    lost: Floats
    spread: Floats
    time: Floats
    passages: NDArray[np.intp]
    p_value: float


@dataclass(frozen=True)
class _Steps:
    """(N,) of all nodes: free time by the model, seconds over it, whether another truck was in the way, or
    nothing was amiss."""

    free: Floats
    over: Floats
    took: Floats
    behind: Mask
    plain: Mask
    cell: Ints
    trip: Ints
    waits: Floats


Passed = tuple[Path, Mask, Ints, Floats]
"""A path, which of its windows count, (W,), the trips of these, (W,), and the seconds that trucks are known
to wait at its nodes, whoever is there, (G,)."""


def lost_time(
    passed: Iterable[Passed], lanes: Stretches, free: Callable[[Path], Floats], known: Floats | None = None
) -> Lost | None:
    """Return the time lost; None where nobody was in the way.

    ``free`` gives the modelled seconds at the nodes of a path; ``known`` (C,) is the share of the time by
    stretch of lane that is known to be lost: it is left out.
    """
    steps = _steps(passed, lanes, free)
    if not steps.behind.any():
        return None
    usual = _usual(steps, len(lanes))[steps.cell] * steps.free + steps.waits
    lost = np.where(steps.behind, steps.over - usual, 0.0)
    if known is not None:
        lost = lost - known[steps.cell] * steps.took
    total = float(steps.took.sum())
    share, touched = float(lost.sum()) / total, float(steps.took[steps.behind].sum()) / total
    by_trip, of_trip = np.bincount(steps.trip, lost), np.bincount(steps.trip, steps.took)
    trips = max(len(by_trip), 2)
    chance = float(np.sqrt(((by_trip - share * of_trip) ** 2).sum() * trips / (trips - 1))) / total
    error = float(np.hypot(chance, MODEL * touched))
    own = np.bincount(steps.trip * len(lanes) + steps.cell, lost, trips * len(lanes)).reshape(-1, len(lanes))
    at = np.asarray(np.bincount(steps.cell, steps.took, len(lanes)), dtype=np.float64)
    return Lost(
        share, error, touched, own.sum(axis=0), np.sqrt((own**2).sum(axis=0)), at, np.count_nonzero(own,
        axis=0),
        float(stdtr(trips - 1, -share / max(error, 1e-12))),
    )  # fmt: skip


def _steps(passed: Iterable[Passed], lanes: Stretches, free: Callable[[Path], Floats]) -> _Steps:
    parts = []
    for path, whole, trip, waits in passed:
        modelled = free(path)
        parts.append((
            modelled, path.took - path.standing - modelled, path.took, path.behind[path.of], whole[path.of],
            lanes.at(path.motion)[0].astype(np.int64), trip[path.of], waits,
        ))  # fmt: skip
    columns = [np.concatenate(c) for c in zip(*parts, strict=True)]
    columns[-2] = np.unique(columns[-2], return_inverse=True)[1]
    return _Steps(*columns)


def _usual(steps: _Steps, cells: int) -> Floats:
    """(C,) share by which undisturbed passages take longer than the model says, by stretch of lane."""
    over, free = (
        np.bincount(steps.cell, np.where(steps.plain, v, 0.0), cells) for v in (steps.over, steps.free)
    )
    everywhere = float(over.sum()) / max(float(free.sum()), 1e-9)
    return np.asarray((over + OWN * everywhere) / (free + OWN))
