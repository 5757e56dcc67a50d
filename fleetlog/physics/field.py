"""A number that varies over the roads: the first parameter of a field term, per stretch of directed edge."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Floats, Motion
from fleetlog.core.network import Network
from fleetlog.errors import InputError, nearest

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {
    "x": "x", "y": "y", "heading": "heading", "from": "start", "to": "end", "value": "value", "low": "low",
    "high": "high", "samples": "samples",
}  # fmt: skip
"""Of a field's Parquet file beside ``edge_id``, each with what it is here; ``from`` and ``to`` may be absent
and then mean the whole edge."""
MARGIN = 2.0
"""Without a map a place belongs to a stretch whose middle is within half its length and this much [m]."""
MAX_TURN = np.pi / 3  # ... and whose heading differs by less than this [rad].


@dataclass(frozen=True)
class Field:
    """N stretches.

    Attributes
    ----------
    edge : (N,) int32 index into the network's edges, -1 where there is no map.
    start, end : (N,) offsets along the edge [m].
    x, y, heading : (N,) middle of the stretch [m, m, rad].
    value, low, high : (N,) the parameter and its interval;  samples : (N,) int64 rows or passages behind it.
    """

    edge: NDArray[np.int32]
    start: Floats
    end: Floats
    x: Floats
    y: Floats
    heading: Floats
    value: Floats
    low: Floats
    high: Floats
    samples: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.value)

    def __getitem__(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> Field:
        """The stretches of an index array or mask."""
        return Field(*(getattr(self, f.name)[index] for f in fields(self)))

    @cached_property
    def _ladder(self) -> tuple[NDArray[np.intp], Floats, float]:
        """Order of the stretches on one axis of edges laid end to end, their starts on it, and its pitch."""
        pitch = float(self.end.max(initial=0.0)) + 1.0
        order = np.lexsort((self.start, self.edge))
        return order, (self.edge * pitch + self.start)[order], pitch

    def along(self, motion: Motion, neutral: float) -> Floats:
        """(N,) the value at each sample of a motion: that of its stretch of edge, without a map of the
        nearest, else ``neutral``."""
        if not len(self):
            return np.full(len(motion), neutral)
        if (motion.edge < 0).all():
            return self._nearest(motion.x, motion.y, motion.heading, neutral)
        order, starts, pitch = self._ladder
        offset = motion.edge_offset
        at = motion.edge * pitch + np.minimum(offset, pitch - 0.5)
        k = order[np.maximum(np.searchsorted(starts, at, side="right") - 1, 0)]
        # The last stretch of an edge takes the offsets that rounding puts just beyond it.
        inside = (offset >= self.start[k] - 1e-6) & (offset <= self.end[k] + 1e-6)
        return np.where(inside & (self.edge[k] == motion.edge) & (motion.edge >= 0), self.value[k], neutral)

    def _nearest(self, x: Floats, y: Floats, heading: Floats, neutral: float) -> Floats:
        from scipy.spatial import cKDTree

        reach = MARGIN + 0.5 * (self.end - self.start)
        near = min(8, len(self))
        tree = cKDTree(np.column_stack([self.x, self.y]))
        found = tree.query(np.column_stack([x, y]), k=near)
        distance, k = (np.asarray(part).reshape(len(x), near) for part in found)
        turn = np.abs(np.angle(np.exp(1j * (heading[:, None] - self.heading[k]))))
        fits = (distance <= reach[k]) & (turn < MAX_TURN)
        best = np.argmax(fits, axis=1)
        row = np.arange(len(x))
        return np.where(fits[row, best], self.value[k[row, best]], neutral)


def stretches(
    network: Network, edge: NDArray[np.int32], start: Floats, end: Floats, value: Floats,
    low: Floats | float = np.nan, high: Floats | float = np.nan, samples: NDArray[np.int64] | int = 0,
) -> Field:  # fmt: skip
    """A field of (N,) stretches ``start`` to ``end`` [m] of a network's directed edges."""
    edge, start, end = np.asarray(edge, np.int32), np.asarray(start, float), np.asarray(end, float)
    n, middle = len(edge), 0.5 * (start + end)
    x, y, _ = network.position(edge, middle).T
    return Field(
        edge, start, end, x, y, network.heading(edge, middle), np.asarray(value, float),
        np.full(n, low), np.full(n, high), np.full(n, samples, np.int64),
    )  # fmt: skip


def mirrored(field: Field, network: Network, odd: bool) -> Field:
    """The field with the other direction of every road that it has in one only, ``odd``: of opposite sign."""
    known = np.zeros(len(network) + 1, dtype=bool)
    known[field.edge] = True
    back = np.where(field.edge >= 0, network.reverse[field.edge], -1).astype(np.int32)
    one_way = field[np.flatnonzero((back >= 0) & ~known[back])]
    if not len(one_way):
        return field
    back = network.reverse[one_way.edge].astype(np.int32)
    length, sign = network.length[back], -1.0 if odd else 1.0
    low, high = (sign * one_way.high, sign * one_way.low) if odd else (one_way.low, one_way.high)
    other = stretches(
        network, back, length - one_way.end, length - one_way.start, sign * one_way.value, low, high,
        one_way.samples
    )  # fmt: skip
    return Field(*(np.concatenate([getattr(field, f.name), getattr(other, f.name)]) for f in fields(Field)))


def field_table(field: Field, network: Network | None) -> pd.DataFrame:
    """The table that is written: ``edge_id`` and the columns of ``COLUMNS``."""
    import pandas as pd

    names = () if network is None else network.edge_ids
    ids = [names[e] if names and e >= 0 else None for e in field.edge]
    return pd.DataFrame({"edge_id": ids, **{key: getattr(field, name) for key, name in COLUMNS.items()}})


def field_of(table: pd.DataFrame, network: Network | None, where: Path) -> Field:
    """The field of a table that was read from ``where``; :class:`InputError` names what it lacks."""
    for column in ("edge_id", "x", "y", "heading", "value"):
        if column not in table:
            raise InputError(f"has no column {column!r}", where=where)
    edge, length = np.full(len(table), -1, np.int32), np.zeros(len(table))
    if network is not None:
        for i, name in enumerate(table["edge_id"].tolist()):
            if isinstance(name, str) and name not in network.index:
                do = f"give the site that it was found on; {nearest(name, network.edge_ids)}"
                raise InputError(f"no edge {name!r} on this site", where=where, place=f"row {i}", do=do)
            edge[i] = network.index[name] if isinstance(name, str) else -1
        length = np.where(edge >= 0, network.length[edge], 0.0)
    numbers = table.reindex(columns=list(COLUMNS)).astype(float)
    numbers["to"] = numbers["to"].where(numbers["to"].notna(), length)
    found = numbers.fillna(dict.fromkeys(("x", "y", "heading", "from", "value", "samples"), 0.0))
    columns = {name: found[key].to_numpy() for key, name in COLUMNS.items()}
    return Field(edge, **{**columns, "samples": columns["samples"].astype(np.int64)})
