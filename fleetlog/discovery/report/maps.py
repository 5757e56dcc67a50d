"""Shapes for the eye: the mismatch over the roads before and after, and power on a bad trip."""

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.result import EdgeValues, Grid, Series, Shape
from fleetlog.discovery.channels.energy import EnergyChannel
from fleetlog.discovery.explain import Explained
from fleetlog.discovery.hypotheses.squares import Squares
from fleetlog.discovery.hypotheses.stretches import Stretches
from fleetlog.discovery.model import Model

FEWEST = 10.0  # Seconds of driving behind a value that is drawn
LONG = 300  # Rows of a trip that is drawn at most


def shapes(e: Explained) -> list[Shape]:
    """Return maps and curves of an energy channel; travel times have maps of their fields only."""
    channel = e.problem.channel
    if not isinstance(channel, EnergyChannel):
        return []
    out: list[Shape] = []
    for name, model in (("before", e.before), ("after", e.after)):
        shape = _mismatch(channel, model, f"mismatch {name}")
        if shape is not None:
            out.append(shape)
    if channel.name == "battery_power":
        out.append(_worst_trip(channel, e.before, e.after))
    return out


def _mismatch(channel: EnergyChannel, model: Model, name: str) -> Shape | None:
    """Mean recorded minus modelled power, by stretch and direction or by square [W]."""
    cells = channel.places
    if cells is None:
        return None
    total, seconds = np.zeros((2, len(cells))), np.zeros((2, len(cells)))
    for unit in channel.units():
        block, _ = unit.own
        m = block.motion
        residual = np.nan_to_num((m.power - channel.evaluation(block, model).power) * m.dt)
        cell, way = cells.at(m)
        on = (cell >= 0) & (m.speed > 0.0)
        at = ((way[on] < 0).astype(int), cell[on])
        np.add.at(total, at, residual[on])
        np.add.at(seconds, at, m.dt[on])
    value, label = total / np.maximum(seconds, 1e-9), "recorded minus modelled power [W]"
    if isinstance(cells, Stretches):
        return _edge_values(cells, value, seconds > FEWEST, name, label)
    assert isinstance(cells, Squares)
    return _grid(cells, value[0], name, label)


def _edge_values(cells: Stretches, value: Floats, known: Mask, name: str, label: str) -> EdgeValues:
    back, length = cells.network.reverse[cells.road_edge], cells.network.length[cells.road_edge]
    parts = []
    for way in (0, 1):
        use = known[way] & (back >= 0 if way else True)
        start, end = (length - cells.end, length - cells.start) if way else (cells.start, cells.end)
        parts.append((np.where(way, back, cells.road_edge)[use], start[use], end[use], value[way][use]))
    edge, start, end, values = (np.concatenate([p[i] for p in parts]) for i in range(4))
    return EdgeValues(name, edge.astype(np.int32), start, end, values, label, diverging=True)


def _grid(squares: Squares, value: Floats, name: str, label: str) -> Grid:
    column, row = (np.floor(squares.middle[:, i] / squares.side).astype(int) for i in (0, 1))
    raster = np.full((int(np.ptp(row)) + 1, int(np.ptp(column)) + 1), np.nan)
    raster[row - row.min(), column - column.min()] = value
    west, south = column.min() * squares.side, row.min() * squares.side
    return Grid(name, raster, west, south, squares.side, label, diverging=True)


def _worst_trip(channel: EnergyChannel, before: Model, after: Model) -> Series:
    """Power over the trip that the model misses most, recorded and modelled before and after."""
    worst, most = None, -1.0
    for unit in channel.units():
        off = np.abs(unit.recorded - channel.predict(unit, before)) * unit.whole
        _, which = np.unique(unit.windows.trip, return_inverse=True)
        sums = np.bincount(which, off)
        if sums.max() > most:
            most, worst = float(sums.max()), (unit, int(unit.windows.trip[which == int(np.argmax(sums))][0]))
    assert worst is not None
    block, _ = worst[0].own
    rows = np.flatnonzero(block.trip == worst[1])[:LONG]
    curves = {"recorded": block.power[rows]}
    for name, model in (("before", before), ("after", after)):
        curves[f"model {name}"] = block.rows(channel.evaluation(block, model).power)[rows]
    time = (block.time[rows] * 1e6).astype(np.int64)
    return Series("worst trip", time, curves, "time", "battery power [W]", over_time=True)
