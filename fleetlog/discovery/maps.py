"""Shapes for the eye: the mismatch over the roads before and after, and predicted against recorded on a worst trip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import EdgeValues, Grid, Series, Shape
from fleetlog.discovery.explain import Explained
from fleetlog.discovery.model import Found
from fleetlog.discovery.residual import Recording
from fleetlog.discovery.squares import Squares
from fleetlog.discovery.stretches import Stretches

Floats = NDArray[np.float64]

FEWEST = 10.0
"""Seconds of driving behind a value that is drawn."""
LONG = 300
"""Rows of a trip that is drawn at most."""


def shapes(explained: Explained) -> list[Shape]:
    """Maps and curves of an energy channel; travel times have maps of their field only."""
    bench = explained.task.recording
    if not isinstance(bench, Recording):
        return []
    before, after = explained.task.base, explained.result.state.found
    out: list[Shape] = []
    for name, found in (("before", before), ("after", after)):
        shape = _mismatch(bench, found, f"mismatch {name}")
        if shape is not None:
            out.append(shape)
    if bench.channel == "battery_power":
        out.append(worst_trip(bench, before, after))
    return out


def _mismatch(bench: Recording, found: Found, name: str) -> Shape | None:
    """Mean recorded minus modelled power by directed stretch [W]."""
    label = "recorded minus modelled power [W]"
    if isinstance(bench.floor, Stretches):
        floor = bench.floor
        total, seconds = np.zeros((2, len(floor))), np.zeros((2, len(floor)))
        for block, _ in bench.pairs():
            m = block.motion
            cell, sign = floor.at(m)
            on = (cell >= 0) & (m.speed > 0.0)
            way = (sign[on] < 0).astype(int)
            residual = m.power - bench.evaluation(block, found).power
            np.add.at(total, (way, cell[on]), np.nan_to_num(residual * m.dt)[on])
            np.add.at(seconds, (way, cell[on]), m.dt[on])
        return _edge_values(floor, total / np.maximum(seconds, 1e-9), seconds > FEWEST, name, label)
    if isinstance(bench.floor, Squares):
        squares = bench.floor
        sums, time = np.zeros(len(squares)), np.zeros(len(squares))
        for block, _ in bench.pairs():
            number = squares.number(block.motion.x, block.motion.y)
            on = number >= 0
            residual = block.motion.power - bench.evaluation(block, found).power
            np.add.at(sums, number[on], np.nan_to_num(residual * block.motion.dt)[on])
            np.add.at(time, number[on], block.motion.dt[on])
        return _grid(squares, sums / np.maximum(time, 1e-9), name, label)
    return None


def _edge_values(
    floor: Stretches, value: Floats, known: NDArray[np.bool_], name: str, label: str
) -> EdgeValues:
    edges, starts, ends, values = [], [], [], []
    back = floor.network.reverse[floor.road_edge]
    length = floor.network.length[floor.road_edge]
    for way in (0, 1):
        use = known[way] & (back >= 0 if way else True)
        edges.append(np.where(way, back, floor.road_edge)[use])
        starts.append((length - floor.end if way else floor.start)[use])
        ends.append((length - floor.start if way else floor.end)[use])
        values.append(value[way][use])
    return EdgeValues(
        name, np.concatenate(edges).astype(np.int32), np.concatenate(starts), np.concatenate(ends), np.concatenate(values),
        label, diverging=True,
    )  # fmt: skip


def _grid(squares: Squares, value: Floats, name: str, label: str) -> Grid:
    column = np.floor(squares.middle[:, 0] / squares.side).astype(int)
    row = np.floor(squares.middle[:, 1] / squares.side).astype(int)
    raster = np.full((int(np.ptp(row)) + 1, int(np.ptp(column)) + 1), np.nan)
    raster[row - row.min(), column - column.min()] = value
    return Grid(
        name,
        raster,
        column.min() * squares.side,
        row.min() * squares.side,
        squares.side,
        label,
        diverging=True,
    )


def worst_trip(bench: Recording, before: Found, after: Found) -> Series:
    """Power over the trip that the nominal model misses most, recorded and modelled before and after."""
    off = np.abs(bench.recorded - _energy(bench, before)) * bench.whole
    _, which = np.unique(bench.windows.trip, return_inverse=True)
    worst = np.flatnonzero(which == int(np.argmax(np.bincount(which, off))))
    vehicle = int(bench.windows.vehicle[worst[0]])
    begin, end = float(bench.windows.time[worst].min()) - 10.0, float(bench.windows.time[worst].max()) + 10.0
    block = next(b for b in bench.blocks if b.vehicle == vehicle and b.time[0] <= end and b.time[-1] >= begin)
    rows = np.flatnonzero((block.time >= begin) & (block.time <= end))[:LONG]
    curves = {"recorded": block.power[rows]}
    for name, found in (("before", before), ("after", after)):
        curves[f"model {name}"] = block.rows(bench.evaluation(block, found).power)[rows]
    return Series(
        "worst trip",
        (block.time[rows] * 1e6).astype(np.int64),
        curves,
        "time",
        "battery power [W]",
        over_time=True,
    )


def _energy(bench: Recording, found: Found) -> Floats:
    return np.concatenate([c.energy(b, bench.evaluation(b, found).power) for b, c in bench.pairs()])
