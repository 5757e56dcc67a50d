"""A field found, as places: which stretches stand out, merged along their roads, with intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.discovery.squares import Squares
from fleetlog.discovery.stretches import Cells, Stretches
from fleetlog.physics.field import Field, stretches
from fleetlog.physics.term import Term

Floats = NDArray[np.float64]

LARGE = 0.35
"""Pieces with this share of the largest deviation belong to where the effect is."""
STANDS_OUT = 0.45
"""Values with this share of what is usual where a field is belong to it."""
FRINGE = 0.8
"""Share of the largest that a single stretch must have to be a place of its own."""
SURE = 1.96
FEW = 3
"""Windows that must touch a piece before it may be named."""


@dataclass(frozen=True)
class Values:
    """A fitted field: ``deviation``, ``error`` by value of the cells, and ``samples`` windows behind each."""

    deviation: Floats
    error: Floats
    samples: NDArray[np.int64]


def usual(values: Floats) -> float:
    """How large values are where they are, however few those places: their root mean square, weighted by the squares."""
    square = values**2
    return float(np.sqrt((square**2).sum() / max(float(square.sum()), 1e-300)))


def stands_out(deviation: Floats) -> NDArray[np.bool_]:
    """(C,) values that are not small beside what is usual where the field is."""
    return np.asarray((np.abs(deviation) >= STANDS_OUT * usual(deviation)) & (deviation**2 > 0.0))


def large(v: Values) -> NDArray[np.bool_]:
    """Values that stand out: significant by themselves and not small beside the largest."""
    known = v.samples >= FEW
    if not known.any():
        return known
    size = np.abs(v.deviation)
    sure = known & (size > SURE * v.error)
    top = float(np.quantile(size[sure], 0.9)) if sure.any() else float(size[known].max())
    return sure & (size >= LARGE * top)


def belonging(cells: Cells, v: Values, term: Term) -> NDArray[np.bool_]:
    """Values that stand out, without the fringe of an even field.

    A single stretch at the end of a road that is next to a place of several is where trucks still brake for it, or gather
    speed again.
    """
    mask = large(v)
    if term.odd or amount(term) or not isinstance(cells, Stretches):
        return mask
    same = cells.road_edge[1:] == cells.road_edge[:-1]
    beside = np.zeros(len(mask), bool)
    beside[1:] |= mask[:-1] & same
    beside[:-1] |= mask[1:] & same
    size = np.abs(v.deviation)
    wide = mask & beside
    if not wide.any():
        return mask
    return np.asarray(wide | (mask & (size >= FRINGE * np.quantile(size[wide], 0.9))))


def amount(term: Term) -> bool:
    """Whether a field is an amount for each passage, which adds up over neighbouring pieces, and not a property of the floor."""
    return term.parameters[0].unit == "s"


def places(cells: Cells, v: Values, term: Term) -> tuple[list[dict[str, Any]], list[float] | None]:
    """``where.edges`` and ``where.extent`` of the contract; squares have no edges."""
    mask = belonging(cells, v, term)
    if isinstance(cells, Stretches):
        rows = _merged(cells, v, mask, term)
        xy = cells.middle()[mask]
    else:
        assert isinstance(cells, Squares)
        rows, both = [], mask.reshape(len(cells), -1).any(axis=1)
        xy = cells.middle[both]
    if not len(xy):
        return rows, None
    low, high = xy.min(axis=0), xy.max(axis=0)
    return rows, [float(low[0]), float(low[1]), float(high[0]), float(high[1])]


def _merged(cells: Stretches, v: Values, mask: NDArray[np.bool_], term: Term) -> list[dict[str, Any]]:
    neutral = term.parameters[0].neutral
    out = []
    for edge in np.unique(cells.road_edge[mask]):
        on = np.flatnonzero(cells.road_edge == edge)
        keep = mask[on].copy()
        # A single quiet stretch between two loud ones of the same sign is part of the place.
        same = np.sign(v.deviation[on])
        keep[1:-1] |= keep[:-2] & keep[2:] & (same[:-2] == same[2:])
        for run in _runs(keep, same):
            c = on[run]
            weight = np.maximum(v.samples[c], 1).astype(float)
            value = float(np.average(v.deviation[c], weights=weight)) + neutral
            error = float(np.sqrt(np.average(v.error[c] ** 2, weights=weight)))
            if amount(term):
                value, error = float(v.deviation[c].sum()), float(np.sqrt((v.error[c] ** 2).sum()))
            out.append({
                "edge_id": cells.network.edge_ids[edge], "from": float(cells.start[c[0]]), "to": float(cells.end[c[-1]]),
                "value": value, "low": value - SURE * error, "high": value + SURE * error,
            })  # fmt: skip
    return sorted(out, key=lambda r: -abs(r["value"] - neutral) * (r["to"] - r["from"]))


def _runs(keep: NDArray[np.bool_], sign: Floats) -> list[NDArray[np.intp]]:
    """Index runs of kept stretches of one sign."""
    runs: list[list[int]] = []
    for i in np.flatnonzero(keep):
        if runs and i == runs[-1][-1] + 1 and sign[i] == sign[runs[-1][-1]]:
            runs[-1].append(int(i))
        else:
            runs.append([int(i)])
    return [np.array(r) for r in runs]


def as_field(cells: Cells, v: Values, term: Term, network: Network | None) -> Field:
    """The whole field for ``fields/TERM.parquet``: every stretch that was driven, in both directions of its road."""
    neutral = term.parameters[0].neutral
    if isinstance(cells, Stretches):
        known = np.flatnonzero(v.samples > 0)
        assert network is not None
        value = neutral + v.deviation[known]
        spread = SURE * v.error[known]
        return stretches(
            network, cells.road_edge[known], cells.start[known], cells.end[known], value,
            value - spread, value + spread, v.samples[known],
        )  # fmt: skip
    assert isinstance(cells, Squares)
    return _square_field(cells, v, term, neutral)


def _square_field(cells: Squares, v: Values, term: Term, neutral: float) -> Field:
    """Squares as stretches without an edge; of an odd field one for each of eight headings."""
    turns = np.arange(8) * np.pi / 4.0 if term.odd else np.zeros(1)
    parts = v.deviation.reshape(len(cells), -1)
    errors = v.error.reshape(len(cells), -1)
    samples = v.samples.reshape(len(cells), -1).max(axis=1)
    rows = []
    for heading in turns:
        weight = np.array([np.cos(heading), np.sin(heading)]) if term.odd else np.ones(1)
        rows.append((neutral + parts @ weight, np.sqrt(errors**2 @ weight**2), np.full(len(cells), heading)))
    value, error, heading_ = (np.concatenate([r[i] for r in rows]) for i in range(3))
    x, y = (np.tile(cells.middle[:, i], len(turns)) for i in (0, 1))
    count = len(value)
    half = np.full(count, cells.side)
    return Field(
        np.full(count, -1, np.int32), np.zeros(count), half, x, y, np.angle(np.exp(1j * heading_)),
        value, value - SURE * error, value + SURE * error, np.tile(samples, len(turns)),
    )  # fmt: skip
