"""The folder of a diagnosis: JSON, model, fields; and the shapes of what is drawn elsewhere."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.result import EdgeValues, Grid, Result, Series, Shape
from fleetlog.core.words import count, listed, percent
from fleetlog.discovery.channels.energy import EnergyChannel
from fleetlog.discovery.channels.energy_columns import EnergyAbout
from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.discovery.hypotheses.cells import Squares, Stretches
from fleetlog.discovery.model import FLEET
from fleetlog.discovery.recording.blocks import Block
from fleetlog.discovery.report import fields
from fleetlog.discovery.report.finding import ChannelFit, Verdict
from fleetlog.discovery.report.words import advice, onward
from fleetlog.physics.field import Field
from fleetlog.physics.model import save_physics
from fleetlog.physics.power import Own, Physics, all_terms
from fleetlog.store.documents import plain, write_json

MOST_LINES = 16
FEWEST = 10.0  # Seconds of driving behind a value that is drawn
LONG = 300  # Rows of a trip that is drawn at most


def write_diagnosis(d: Diagnosis, folder: Path) -> None:
    """Write everything but what is drawn into an existing folder."""
    write_json(folder / "diagnosis.json", d.verdict.document(), indent=1)
    save_physics(folder, physics(d), d.fleet.network)
    (folder / "fields").mkdir(exist_ok=True)


def physics(d: Diagnosis) -> Physics:
    """Return the model found: numbers of the fleet and single trucks, fields by stretch, intervals."""
    found: dict[str, Field] = {}
    intervals: dict[str, dict[str, tuple[float, float]]] = {}
    timed: list[Own] = []
    for e in d.channels.values():
        for name, values in e.fields.items():
            term = all_terms()[name]
            found[name] = fields.as_field(e.problem.channel.cells(term), values, term)
            when = d.found.when.get(name, FLEET)
            if when.timed:
                timed.append(Own({}, None, when.begin, when.until, when.drift, {name: found.pop(name)}))
        for knob, n in e.numbers.items():
            if knob.scope.whole:
                intervals.setdefault(knob.term, {})[knob.parameter] = (n.low, n.high)
    own = [replace(o, vehicles=(v,)) for i, v in enumerate(d.fleet.vehicles) for o in d.found.own(i)]
    told = (*_gathered(own, d.fleet.vehicles), *timed)
    return Physics(d.fleet.truck, dict(d.found.values()), fields=found, intervals=intervals, own=told)


def _gathered(own: list[Own], vehicles: tuple[str, ...]) -> tuple[Own, ...]:
    """What vehicles have in common told once, of all where it is all."""
    alike: list[Own] = []
    for o in own:
        if same := [i for i, a in enumerate(alike) if replace(a, vehicles=o.vehicles) == o]:
            alike[same[0]] = replace(o, vehicles=(*(alike[same[0]].vehicles or ()), *(o.vehicles or ())))
        else:
            alike.append(o)
    return tuple(replace(a, vehicles=None) if a.vehicles == vehicles else a for a in alike)


def as_result(d: Diagnosis) -> Result:
    """Return the diagnosis for ``view``."""
    return Result("diagnosis", plain(d.verdict.document()), shapes=shapes(d), lines=lines(d))


HEADS = {
    "none": "Nothing is missing: recording and model agree within the noise of the recording.",
    "unnamed": "The recording differs from the model in a way that is told below, but that no term names.",
    "unknown": "The recording differs from the model, and known physics does not explain all of it.",
    "unjudged": "Too little was recorded to judge any channel.",
}


def head(v: Verdict) -> str:
    """Return the verdict in one sentence."""
    if not any(c.judged for c in v.channels):
        return HEADS["unjudged"]
    if v.word == "none" and not v.passes:
        told, untold = ([c.name for c in v.channels if c.judged == known] for known in (True, False))
        names = ", ".join(untold + [f"truck {name}" for name in v.left_out])
        return f"Nothing is missing in {listed(told)}. Not judged: {names}."
    found = f"The model leaves out {count(len(v.findings), 'effect')}."
    described = not v.unexplained and all(f.physics or f.term != "unknown" for f in v.findings)
    return HEADS.get("unnamed" if v.word == "unknown" and described else v.word, found)


def lines(d: Diagnosis) -> list[str]:
    """Return the answer in a few lines for a terminal."""
    v = d.verdict
    out = [head(v)]
    for f in v.findings[:4]:
        out += [f"  {f.term} ({f.channel}): {f.statement}.", f"    What to do: {advice(f)}."]
        out += [f"    {more}"] if (more := onward(f)) else []
    out += [_channel(c, c.name in v.unexplained) for c in v.channels]
    return [*out, *(f"  note: {n}" for n in v.notes[: max(MOST_LINES - len(out), 0)])]


def _channel(c: ChannelFit, unexplained: bool) -> str:
    if c.reason is not None or c.before is None or c.after is None:
        return f"  {c.name}: not judged: {c.reason}"
    floor = "" if c.floor is None else f", noise floor {percent(c.floor, 1)}"
    more = "; the rest is unexplained" if unexplained else ""
    return f"  {c.name}: error on held-out trips {percent(c.before, 1)} -> {percent(c.after, 1)}{floor}{more}"


def shapes(d: Diagnosis) -> list[Shape]:
    """Return the mismatch over the roads before and after, and power on a bad trip, of the first energy
    channel; travel times have maps of their fields only."""
    e = next((d.channels[c] for c in ("battery_power", "soc") if c in d.channels), None)
    if e is None:
        return []
    channel = e.problem.channel
    assert isinstance(channel, EnergyChannel)
    cells, models = channel.places, (e.before, e.after)
    shape = 2, 0 if cells is None else len(cells)  # By direction and cell
    total, seconds = np.zeros((2, *shape)), np.zeros(shape)
    worst, most = None, -1.0
    for unit in channel.units():
        abouts = [channel.about(unit.own, model) for model in models]
        _, which = np.unique(unit.windows.trip, return_inverse=True)
        sums = np.bincount(which, np.abs(unit.recorded - abouts[0].modelled) * unit.whole)
        if sums.max() > most:
            rows = unit.own.block.trip == unit.windows.trip[which == int(np.argmax(sums))][0]
            most, worst = float(sums.max()), _series(unit.own.block, np.flatnonzero(rows)[:LONG], abouts)
        if cells is not None:
            m = unit.own.motion
            cell, way = cells.at(m)
            on = (cell >= 0) & (m.speed > 0.0)
            at = (way[on] < 0) * len(cells) + cell[on]
            seconds += np.bincount(at, m.dt[on], seconds.size).reshape(shape)
            for own, about in zip(total, abouts, strict=True):
                residual = np.nan_to_num((m.power - about.e.power) * m.dt)
                own += np.bincount(at, residual[on], seconds.size).reshape(shape)
    label, out = "recorded minus modelled power [kW]", list[Shape]()
    for name, own in zip(("mismatch before", "mismatch after"), total, strict=True):
        value = own / np.maximum(1000.0 * seconds, 1e-6)
        if isinstance(cells, Stretches):
            out.append(_edge_values(cells, value, seconds > FEWEST, name, label))
        elif isinstance(cells, Squares):
            out.append(_grid(cells, value[0], name, label))
    return [*out, worst] if channel.name == "battery_power" and worst is not None else out


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


def _series(block: Block, rows: Ints, abouts: Sequence[EnergyAbout]) -> Series:
    """Power over some rows of a block, recorded and modelled before and after."""
    curves = {"recorded": block.power[rows]}
    for name, about in zip(("before", "after"), abouts, strict=True):
        curves[f"model {name}"] = block.rows(about.e.power)[rows]
    time, kilowatts = (block.time[rows] * 1e6).astype(np.int64), {n: y / 1000.0 for n, y in curves.items()}
    return Series("worst trip", time, kilowatts, "time", "battery power [kW]", over_time=True)
