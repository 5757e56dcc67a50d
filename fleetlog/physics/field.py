"""A number that varies over the roads: the first parameter of a field term, per stretch of directed edge."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats, Index, Indices, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.errors import InputError, nearest

MARGIN = 2.0  # Without a map a place is on a stretch whose middle is, east and north, within half its length
MAX_TURN = np.pi / 3  # and this [m], as squares have corners, and whose heading differs by less [rad].


@dataclass(frozen=True)
class Field:
    """N stretches, (N,) each."""

    edge: Index  # Index into the network's edges, -1 where there is no map
    x: Floats  # Middle of the stretch [m]
    y: Floats
    heading: Floats  # There [rad]
    start: Floats  # Offsets along the edge [m]
    end: Floats
    value: Floats  # Of the parameter
    low: Floats  # Its interval
    high: Floats
    samples: Ints  # Rows or passages behind it

    def __len__(self) -> int:
        return len(self.value)

    def __getitem__(self, index: Indices | Mask) -> "Field":
        """The stretches of an index array or mask."""
        return Field(*(getattr(self, f.name)[index] for f in fields(self)))

    def along(self, motion: Motion, neutral: float) -> Floats:
        """(N,) the value at each sample of a motion: that of its stretch of edge, without a map of the
        nearest, else ``neutral``."""
        if not len(self):
            return np.full(len(motion), neutral)
        if (motion.edge < 0).all():
            return self._nearest(motion.x, motion.y, motion.heading, neutral)
        # Edges are laid end to end on one axis, so that one search serves all.
        order, pitch = np.lexsort((self.start, self.edge)), float(self.end.max()) + 1.0
        offset = motion.edge_offset
        at = motion.edge * pitch + np.minimum(offset, pitch - 0.5)
        k = np.searchsorted((self.edge * pitch + self.start)[order], at, side="right") - 1
        k = order[np.maximum(k, 0)]
        # The last stretch of an edge takes the offsets that rounding puts just beyond it.
        inside = (offset >= self.start[k] - 1e-6) & (offset <= self.end[k] + 1e-6)
        return np.where(inside & (self.edge[k] == motion.edge) & (motion.edge >= 0), self.value[k], neutral)

    def _nearest(self, x: Floats, y: Floats, heading: Floats, neutral: float) -> Floats:
        from scipy.spatial import cKDTree

        reach = MARGIN + 0.5 * (self.end - self.start)
        tree = cKDTree(np.column_stack([self.x, self.y]))
        distance, k = tree.query(np.column_stack([x, y]), k=np.arange(1, min(8, len(self)) + 1), p=np.inf)
        turn = np.abs(np.angle(np.exp(1j * (heading[:, None] - self.heading[k]))))
        fits = (distance <= reach[k]) & (turn < MAX_TURN)
        best = np.argmin(np.where(fits, distance + 1e-6 * turn, np.inf), axis=1)  # Of one place the heading
        row = np.arange(len(x))
        return np.where(fits[row, best], self.value[k[row, best]], neutral)


def stretches(
    network: Network, edge: Index, start: Floats, end: Floats, value: Floats,
    low: Floats | float = np.nan, high: Floats | float = np.nan, samples: Ints | int = 0,
) -> Field:  # fmt: skip
    """A field of (N,) stretches ``start`` to ``end`` [m] of a network's directed edges."""
    edge, start, end = np.asarray(edge, np.int32), np.asarray(start, float), np.asarray(end, float)
    n, middle = len(edge), 0.5 * (start + end)
    x, y, _ = network.position(edge, middle).T
    return Field(
        edge, x, y, network.heading(edge, middle), start, end, np.asarray(value, float),
        np.full(n, low), np.full(n, high), np.full(n, samples, np.int64),
    )  # fmt: skip


def mirrored(field: Field, network: Network, odd: bool) -> Field:
    """The field with the other direction of every road that it has in one only, ``odd``: of opposite sign."""
    back = np.where(field.edge >= 0, network.reverse[field.edge], -1).astype(np.int32)
    lone = (back >= 0) & ~np.isin(back, field.edge)
    back, one_way = back[lone], field[lone]
    length, bounds = network.length[back], (one_way.value, one_way.low, one_way.high)
    if odd:
        bounds = -one_way.value, -one_way.high, -one_way.low
    other = stretches(network, back, length - one_way.end, length - one_way.start, *bounds, one_way.samples)
    return Field(*(np.concatenate([getattr(field, f.name), getattr(other, f.name)]) for f in fields(Field)))


NUMBERS = [f.name for f in fields(Field)][1:]
COLUMNS = [{"start": "from", "end": "to"}.get(name, name) for name in NUMBERS]
"""Of a field's Parquet file beside ``edge_id``; without ``from`` and ``to`` the whole edge is meant."""


def save_field(path: Path, field: Field, network: Network | None) -> None:
    """Write a field of a network as Parquet."""
    import pandas as pd

    ids = [network.edge_ids[e] if network is not None and e >= 0 else None for e in field.edge]
    columns = dict(zip(COLUMNS, (getattr(field, name) for name in NUMBERS), strict=True))
    path.parent.mkdir(exist_ok=True)
    pd.DataFrame({"edge_id": ids, **columns}).to_parquet(path, index=False)


def load_field(path: Path, network: Network | None) -> Field:
    """Read a field that lies on a network; :class:`InputError` names what it lacks."""
    import pandas as pd
    import pyarrow as pa

    try:
        table = pd.read_parquet(path)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"not readable as Parquet: {error}", where=path) from None
    for column in ("edge_id", "x", "y", "heading", "value"):
        if column not in table:
            raise InputError(f"has no column {column!r}", where=path)
    edge, length = np.full(len(table), -1, np.int32), np.zeros(len(table))
    if network is not None:
        for i, name in enumerate(table["edge_id"].tolist()):
            if isinstance(name, str) and name not in network.index:
                do = f"give the site that it was found on; {nearest(name, network.edge_ids)}"
                raise InputError(f"no edge {name!r} on this site", where=path, place=f"row {i}", do=do)
            edge[i] = network.index[name] if isinstance(name, str) else -1
        length = np.where(edge >= 0, network.length[edge], 0.0)
    numbers = table.reindex(columns=COLUMNS).astype(float).set_axis(NUMBERS, axis="columns")
    numbers["end"] = numbers["end"].where(numbers["end"].notna(), length)
    numbers = numbers.fillna(dict.fromkeys({*NUMBERS} - {"low", "high"}, 0.0)).astype({"samples": np.int64})
    return Field(edge, **{name: numbers[name].to_numpy() for name in NUMBERS})
