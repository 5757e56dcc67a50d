"""Tasks, activities and reservations of a simulated dataset as arrays, on the recording's clock."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Place, PlaceKind, Site
from fleetlog.core.trajectory import Floats, Ints
from fleetlog.store import Dataset
from fleetlog.store.events import ACTIVITIES, TABLES, read_table
from fleetlog.view import palette
from fleetlog.view.day import Day

if TYPE_CHECKING:
    import pandas as pd

MOMENTS = ("earliest", "assigned", "picked", "dropped")
NEVER = np.iinfo(np.int64).max
"""A time that has not come [us]."""


@dataclass(frozen=True)
class Tasks:
    """N tasks: times [us], ``NEVER`` where not reached; ends (N, 3) m, NaN where not decided."""

    vehicle: NDArray[np.object_]
    earliest: Ints
    assigned: Ints
    picked: Ints
    dropped: Ints
    source: Floats
    target: Floats


@dataclass(frozen=True)
class Happenings:
    """What a simulated dataset says beside its rows.

    ``doing`` (N,) activity, ``who`` (N,) vehicle, ``start``, ``end`` [us] and ``where`` (N, 3) m of
    stretches; ``held_by``, ``held_from``, ``held_to`` [us], ``way`` (M,) of reservations, and the ``lines``
    (n, 3) m of the ways; ``spots`` are places that the simulation drew along the roads.
    """

    tasks: Tasks
    doing: NDArray[np.object_]
    who: NDArray[np.object_]
    start: Ints
    end: Ints
    where: Floats
    held_by: NDArray[np.object_]
    held_from: Ints
    held_to: Ints
    way: Ints
    lines: dict[int, Floats]
    spots: tuple[Place, ...]


def happenings_of(dataset: Dataset, shift: int) -> Happenings | None:
    """None for a dataset without them; times are moved by ``shift`` [us]."""
    tasks, doing, held, ways, bays = (read_table(dataset, name, compact=True) for name in TABLES)
    if tasks is None or doing is None or held is None or ways is None or bays is None:
        return None
    middles = bays.groupby("place", observed=True)[["x", "y", "z"]].mean()
    spots = dict(zip(middles.index.astype(str), middles.to_numpy(np.float64), strict=True))
    clock = partial(_times, shift=shift)
    if isinstance(dataset, Day):
        first, last = dataset.span
        clock = partial(_times, shift=shift, first=first, last=last)
        doing, held = (t[(_times(t["end"]) >= first) & (_times(t["start"]) <= last)] for t in (doing, held))
    given = tasks[tasks["status"] != "left out"]
    earliest, assigned, picked, dropped = (clock(given[c]) for c in MOMENTS)
    source, target = (_places(given[c], spots) for c in ("from_place", "to_place"))
    who = given["vehicle_id"].to_numpy(object)
    book = Tasks(who, earliest, assigned, picked, dropped, source, target)
    return Happenings(
        book, doing["activity"].to_numpy(object), doing["vehicle_id"].to_numpy(object), clock(doing["start"]),
        clock(doing["end"]), _places(doing["place"], spots), held["vehicle_id"].to_numpy(object),
        clock(held["start"]), clock(held["end"]), held["way"].to_numpy(np.int64), _lines(ways),
        _drawn(bays, dataset.site),
    )  # fmt: skip


def _times(column: pd.Series[Any], shift: int = 0, first: int = -NEVER, last: int = NEVER) -> Ints:
    """What lies outside the time that is shown, from ``first`` to ``last``, is moved to its ends."""
    values = column.dt.tz_localize(None).to_numpy("datetime64[us]")
    return np.where(np.isnat(values), NEVER, np.clip(values.astype(np.int64), first, last) + shift)


def _places(names: pd.Series[Any], spots: dict[str, Floats]) -> Floats:
    """(N, 3) m, NaN where no place is named."""
    known, nowhere = names.astype("category").cat, np.full(3, np.nan)
    # The code of no name is -1: the last row.
    where = np.array([*(spots.get(str(n), nowhere) for n in known.categories), nowhere], dtype=np.float64)
    return np.asarray(where[known.codes.to_numpy()])


def _drawn(bays: pd.DataFrame, site: Site) -> tuple[Place, ...]:
    """Places of the simulation that the site does not have."""
    known = {p.id for p in site.places}
    names, kinds = bays["place"].astype(str), bays["kind"].astype(str)
    rows = zip(names, kinds, bays[["x", "y"]].to_numpy(float).tolist(), strict=True)
    return tuple(Place(name, cast(PlaceKind, kind), *xy) for name, kind, xy in rows if name not in known)


def _lines(ways: pd.DataFrame) -> dict[int, Floats]:
    shapes = zip(*(ways[c] for c in "xyz"), strict=True)
    return {
        int(number): np.column_stack([np.asarray(c, dtype=np.float64) for c in shape])
        for number, shape in zip(ways["way"].to_numpy(), shapes, strict=True)
    }


def rows_while(times: Ints, start: Ints, end: Ints) -> tuple[Ints, Ints]:
    """Row and stretch wherever one of the sorted ``times`` lies from ``start`` to before ``end``, by row."""
    first, last = np.searchsorted(times, start), np.searchsorted(times, end)
    count = np.maximum(last - first, 0)
    stretch = np.repeat(np.arange(len(start)), count)
    row = np.arange(len(stretch)) + np.repeat(first - (np.cumsum(count) - count), count)
    order = np.argsort(row, kind="stable")
    return row[order], stretch[order]


def mean_number(edges: Ints, start: Ints, end: Ints) -> Floats:
    """(T - 1,) how many stretches there are on average between each two of the (T,) ``edges``."""
    return np.asarray(np.diff(_behind(edges, start) - _behind(edges, end)) / np.diff(edges))


def _behind(edges: Ints, moments: Ints) -> Ints:
    """(T,) sum of the time from each of the ``moments`` to each of the ``edges`` that is later [us]."""
    moments = np.sort(np.clip(moments, edges[0], edges[-1])) - edges[0]
    passed = np.searchsorted(moments, edges - edges[0])
    sums = np.concatenate([[0], np.cumsum(moments)])
    return np.asarray(passed * (edges - edges[0]) - sums[passed], dtype=np.int64)


def counts(h: Happenings, edges: Ints) -> dict[str, Floats]:
    """(T - 1,) mean number of trucks by activity, for those that occur."""
    found = {a: h.doing == a for a in ACTIVITIES}
    return {a: mean_number(edges, h.start[mine], h.end[mine]) for a, mine in found.items() if mine.any()}


def open_tasks(t: Tasks, edges: Ints) -> dict[str, Floats]:
    """(T - 1,) mean number of tasks at each stage that occurs."""
    moments = itertools.pairwise(getattr(t, name) for name in MOMENTS)
    numbers = {name: mean_number(edges, *ends) for name, ends in zip(palette.STAGES, moments, strict=True)}
    return {name: n for name, n in numbers.items() if n.any()}
