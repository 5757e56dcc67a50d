"""Tasks, activities and reservations of a simulated dataset, on the recording's clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from fleetlog.core.site import Place, PlaceKind
from fleetlog.core.trajectory import Floats, Ints
from fleetlog.store import Dataset
from fleetlog.store.events import TABLES, read_table
from fleetlog.view.clock import OneDay, span_of

if TYPE_CHECKING:
    import pandas as pd

NEVER = np.iinfo(np.int64).max
"""A time that has not come [us]."""


@dataclass(frozen=True)
class Happenings:
    """What a simulated dataset says beside its rows.

    The tables ``tasks``, ``activities`` and ``reservations`` with times [us, int64], ``NEVER`` where not
    reached; ``spots`` x, y, z [m] by place; ``lines`` (n, 3) m by way; ``drawn`` places that the simulation
    drew along the roads.
    """

    tasks: pd.DataFrame
    activities: pd.DataFrame
    reservations: pd.DataFrame
    spots: pd.DataFrame
    lines: dict[int, Floats]
    drawn: tuple[Place, ...]

    def where(self, places: pd.Series[Any]) -> Floats:
        """(N, 3) m, NaN where no place is named."""
        return self.spots.reindex(places.astype(object)).to_numpy(np.float64)


def happenings_of(dataset: Dataset, shift: int) -> Happenings | None:
    """None for a dataset without them; times are moved by ``shift`` [us]."""
    tasks, doing, held, ways, bays = (read_table(dataset, name, compact=True) for name in TABLES)
    if tasks is None or doing is None or held is None or ways is None or bays is None:
        return None
    first, last = (isinstance(dataset, OneDay) and span_of(dataset)) or (-NEVER, NEVER)

    def clocked(table: pd.DataFrame) -> pd.DataFrame:
        """What lies outside the time that is shown is moved to its ends."""
        columns = table.select_dtypes("datetimetz")
        times = {str(c): columns[c].dt.tz_localize(None).to_numpy("datetime64[us]") for c in columns}
        moved = {c: np.clip(t.astype(np.int64), first, last) + shift for c, t in times.items()}
        return table.assign(**{c: np.where(np.isnat(times[c]), NEVER, t) for c, t in moved.items()})

    doing, held = (t[t["end"] > t["start"]] for t in map(clocked, (doing, held)))
    spots = bays.groupby("place", observed=True)[["x", "y", "z"]].mean()
    shapes = zip(*(ways[c] for c in "xyz"), strict=True)
    lines = {int(way): np.column_stack(shape) for way, shape in zip(ways["way"], shapes, strict=True)}
    known = {p.id for p in dataset.site.places}
    rows = zip(bays["place"].astype(str), bays["kind"].astype(str), bays["x"], bays["y"], strict=True)
    drawn = tuple(Place(name, cast(PlaceKind, kind), *xy) for name, kind, *xy in rows if name not in known)
    given = clocked(tasks[tasks["status"] != "left out"])
    return Happenings(given, doing, held, spots.set_axis(spots.index.astype(str)), lines, drawn)


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
