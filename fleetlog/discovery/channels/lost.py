"""What other trucks cost: time on stretches where one was in the way, over what they take otherwise."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.discovery.channels.paths import Path
from fleetlog.discovery.hypotheses.cells import Stretches

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
    # (N,) of all nodes: time by the model, what was taken beyond it, whether another truck was in the way,
    # or nothing was amiss.
    parts = []
    for path, whole, of_window, waits in passed:
        modelled = free(path)
        parts.append((
            modelled, path.took - path.standing - modelled, path.took, path.behind[path.of], whole[path.of],
            lanes.at(path.motion)[0].astype(np.int64), of_window[path.of], waits,
        ))  # fmt: skip
    nominal, over, took, behind, plain, cell, code, wait = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    if not behind.any():
        return None
    _, trip = np.unique(code, return_inverse=True)
    # By how much undisturbed passages take longer than the model says, by stretch of lane.
    more, base = (np.bincount(cell, np.where(plain, v, 0.0), len(lanes)) for v in (over, nominal))
    usual = (more + OWN * float(more.sum()) / max(float(base.sum()), 1e-9)) / (base + OWN)
    lost = np.where(behind, over - usual[cell] * nominal - wait, 0.0)
    if known is not None:
        lost = lost - known[cell] * took
    total = float(took.sum())
    share, touched = float(lost.sum()) / total, float(took[behind].sum()) / total
    by_trip, of_trip = np.bincount(trip, lost), np.bincount(trip, took)
    trips = max(len(by_trip), 2)
    chance = float(np.sqrt(((by_trip - share * of_trip) ** 2).sum() * trips / (trips - 1))) / total
    error = float(np.hypot(chance, MODEL * touched))
    own = np.bincount(trip * len(lanes) + cell, lost, trips * len(lanes)).reshape(-1, len(lanes))
    at = np.asarray(np.bincount(cell, took, len(lanes)), dtype=np.float64)
    return Lost(
        share, error, touched, own.sum(axis=0), np.sqrt((own**2).sum(axis=0)), at, np.count_nonzero(own,
        axis=0),
        float(stdtr(trips - 1, -share / max(error, 1e-12))),
    )  # fmt: skip
