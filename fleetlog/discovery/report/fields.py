"""A field found, as places: which stretches stand out, merged along their roads, with intervals."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fleetlog.core.arrays import Floats, Indices, Ints, Mask
from fleetlog.discovery.hypotheses.cells import LARGE, Cells, Squares, Stretches
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import field_values
from fleetlog.discovery.recording.turns import REACH
from fleetlog.discovery.report.finding import NORMAL, Parameter, interval
from fleetlog.physics.field import Field, stretches
from fleetlog.physics.term import Parameter as Definition
from fleetlog.physics.term import Term

FREE = Definition("free", "", -np.inf, np.inf)  # What a place has of its own, in watts or a share of the time
PART = 12.0  # Of a road: windows hardly tell stretches that are nearer from one another [m]
FEW = 3  # Windows that must touch a piece before it may be named
DRAWS = 400  # Of the field, for what picking the largest of its values costs


@dataclass(frozen=True)
class Values:
    """A fitted field: ``deviation`` (C,) of its coordinate by value of the cells, ``samples`` windows behind
    each, ``basis`` (C, k) and ``covariance`` (k, k) of its coefficients, of which ``scatter`` (k, k) is what
    trips differ by, and the rest what a prior left open."""

    deviation: Floats
    samples: Ints
    basis: Floats
    covariance: Floats
    scatter: Floats

    @property
    def error(self) -> Floats:
        """The standard error of every value, (C,)."""
        square = (self.basis @ self.covariance * self.basis).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)), dtype=np.float64)

    @property
    def surest(self) -> Floats:
        """Of a field of vectors the heading in which each is known best, (C / 2,): that of its road."""
        own = self.basis.reshape(len(self.basis) // 2, 2, -1)
        (xx, xy), (_, yy) = np.einsum("ijk,kl,iml->jmi", own, self.covariance, own, optimize=True)
        return np.asarray(0.5 * (np.arctan2(2.0 * xy, xx - yy) + np.pi))

    def along(self, way: Floats) -> "Values":
        """Return a field of vectors as its part along directions, (C, 2) unit vectors: what roads do not
        follow is unknown, and no part of it."""
        basis = np.einsum("ij,ijk->ik", way, self.basis.reshape(len(way), 2, -1))
        own, samples = (self.deviation.reshape(-1, 2) * way).sum(axis=1), self.samples.reshape(-1, 2)
        return replace(self, deviation=own, samples=samples.max(axis=1), basis=basis)

    def of(self, run: Indices, *, whole: bool = False) -> tuple[float, float]:
        """Return the mean of some values, weighted by their windows, or their sum; and its standard error."""
        weight = np.ones(len(run)) if whole else (n := np.maximum(self.samples[run], 1)) / n.sum()
        own = weight @ self.basis[run]
        return float(weight @ self.deviation[run]), max(float(own @ self.covariance @ own), 0.0) ** 0.5


def large(v: Values) -> Mask:
    """Return the values that stand out: significant by themselves and not small beside the largest."""
    size = np.abs(v.deviation)
    sure = (v.samples >= FEW) & (size > NORMAL * v.error) & (size > 0.0)
    least = LARGE * float(np.quantile(size[sure], 0.9)) if sure.any() else np.inf
    return np.asarray(sure & (size >= least))


def together(cells: Cells, v: Values) -> Mask:
    """The same, and on roads as large values beside each other that stand out together: pieces of a road are
    hardly told from one another, so that each may be uncertain where all of them are not."""
    size, known, out = np.abs(v.deviation), v.samples >= FEW, large(v)
    if not isinstance(cells, Stretches):
        return out
    top = np.quantile(size[out], 0.9) if out.any() else size[known].max(initial=0.0)
    for run in cells.runs(known & (size >= LARGE * top), np.sign(v.deviation)):
        mean, error = v.of(run)
        out[run] |= abs(mean) > NORMAL * error
    return out


def told(cells: Cells, v: Values, h: Hypothesis) -> tuple[dict[str, Any] | None, list[Parameter]]:
    """Return where a field stands out (the contract's ``where``), and the size of a term's as a number."""
    if v.deviation.size > len(cells):  # Vectors: their length, in their direction
        way = v.deviation.reshape(-1, 2)
        v = v.along(way / np.maximum(np.hypot(*way.T), 1e-12)[:, None])
    mask = large(v) if h.waits else together(cells, v)
    if isinstance(cells, Stretches) and not h.waits:
        # Where trucks leave one road for the next, what is told may be of either.
        inner = cells.inner(mask, np.sign(v.deviation), REACH)
        mask = inner if inner.any() else mask
    even = bool(h.patterns) and not any(" m" in p.label for p in h.patterns)
    if not mask.any():
        mask = np.abs(v.deviation) >= LARGE * float(np.abs(v.deviation).max(initial=0.0))
    rows = _merged(cells, v, mask, h.physics) if isinstance(cells, Stretches) else []
    where = {"edges": rows, "extent": cells.extent(mask)}
    return (None if even and not rows else where), [_size(cells, v, mask, h.physics)] if h.physics else []


def _size(cells: Cells, v: Values, mask: Mask, term: Term) -> Parameter:
    """The largest value of an odd field, corrected for being picked; of others the mean."""
    first = term.parameters[0]
    if term.odd:
        mask = sure if (sure := mask & large(v)).any() else mask
        none, chance, both = np.zeros(len(v.scatter)), np.random.default_rng(0), (v.covariance, v.scatter)
        draws = [chance.multivariate_normal(none, c, DRAWS, method="eigh") for c in both]
        parts = [np.flatnonzero(mask)[:, None]]
        if isinstance(cells, Stretches):
            count = max(1, round(PART / float(np.mean(cells.end - cells.start))))
            runs = cells.runs(mask, np.sign(v.deviation))
            parts = [sliding_window_view(r, min(len(r), count)) for r in runs]
        here, basis = (np.concatenate([of[p].mean(axis=1) for p in parts]) for of in (v.deviation, v.basis))
        largest, again = (np.abs(here + d @ basis.T).max(axis=1) for d in draws)
        low, middle, high = np.quantile(largest, [0.025, 0.5, 0.975])
        # The largest of many uncertain values is too large by what one more scatter of the same size adds, or
        # all error, at the most: of what a prior left open, which draws all to zero, nobody knows how much.
        likeliest = float(np.abs(here).max())
        value = less if (less := 2.0 * likeliest - float(np.median(again))) > 0.0 else likeliest
        below, above = max(2.0 * likeliest + float(low - 2.0 * middle), 0.0), value + float(high - middle)
        return Parameter(term.extreme or first.name, value, below, above, first.unit)
    run = np.flatnonzero(mask)
    if waits := isinstance(cells, Stretches) and term.waits:
        # Seconds add up along a passage: the longest wait is that of the worst run of cells.
        run = max(cells.runs(mask, np.sign(v.deviation)), key=lambda r: float(v.deviation[r].sum()))
    value, error = v.of(run, whole=waits)
    return interval(first, first.scaled(first.neutral) + value, error, first.neutral)


def row(cells: Stretches, run: Indices, value: float, low: float, high: float) -> dict[str, Any]:
    """Return what holds on a run of stretches, as the contract writes it."""
    return {
        "edge_id": cells.network.edge_ids[cells.road_edge[run[0]]], "from": float(cells.start[run[0]]),
        "to": float(cells.end[run[-1]]), "value": value, "low": low, "high": high,
    }  # fmt: skip


def _merged(cells: Stretches, v: Values, mask: Mask, term: Term | None) -> list[dict[str, Any]]:
    first, waits = (term.parameters[0], term.waits) if term else (FREE, False)
    zero = first.scaled(first.neutral)
    out = []
    for c in cells.runs(mask, np.sign(v.deviation), bridged=True):
        value, error = v.of(c, whole=waits)
        n = interval(first, zero + value, error, first.neutral)
        out.append(row(cells, c, n.value, n.low, n.high))
    return sorted(out, key=lambda r: -abs(r["value"] - first.neutral) * (r["to"] - r["from"]))


def as_field(cells: Cells, v: Values, term: Term) -> Field:
    """The whole field for ``fields/TERM.parquet``: every stretch driven, in both directions of its road; and
    squares as stretches without an edge, one for each of eight headings, of an odd field the surest first."""
    first = term.parameters[0]
    if isinstance(cells, Stretches):
        known = np.flatnonzero(v.samples > 0)
        own, half = v.deviation[known], NORMAL * v.error[known]
        middle, low, high = (field_values(first, own + s * half) for s in (0.0, -1.0, 1.0))
        return stretches(
            cells.network, cells.road_edge[known], cells.start[known], cells.end[known], middle,
            np.minimum(low, high), np.maximum(low, high), v.samples[known],
        )  # fmt: skip
    assert isinstance(cells, Squares)
    turns = 0.25 * np.pi * np.arange(8)[:, None]
    heading = np.angle(np.exp(1j * (turns + (v.surest if term.odd else np.zeros(len(cells))))))
    ways = np.stack([np.cos(heading), np.sin(heading)], axis=2)
    parts = [v.along(way) if term.odd else v for way in ways]
    names = ("deviation", "error", "samples")
    value, error, samples = (np.concatenate([getattr(p, n) for p in parts]) for n in names)
    value, half = first.neutral + value, NORMAL * error
    x, y = np.tile(cells.middle, (len(turns), 1)).T
    nothing, side = np.zeros(len(value)), np.full(len(value), cells.side)
    edge = np.full(len(value), -1, np.int32)
    return Field(edge, x, y, heading.ravel(), nothing, side, value, value - half, value + half, samples)
