"""``recording.rrd``: the replay of a dataset.

Many trucks have one row a time step for the whole fleet, and curves of the fleet instead of every truck.
Rows of a vehicle each would cost more than twice the file, and two hundred curves in a plot say nothing::

    PREFIX/trucks/bodies   one mesh at the pose of every truck      PREFIX/speed/...  quantiles of the moving
    PREFIX/trucks/loads    loads on the forks                       PREFIX/power/...  sum of the fleet
    PREFIX/trucks/charge   a dot over each truck, coloured by SOC   PREFIX/soc/...    lowest, median, highest
    PREFIX/trail/fleet     where they were"""

import itertools
import tempfile
import tomllib
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import rerun as rr

from fleetlog.core.arrays import DAY, Floats, Ints, microseconds
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset
from fleetlog.store.days import each_day
from fleetlog.view import blueprint, clock, events, palette
from fleetlog.view import fleet as of
from fleetlog.view.clock import SKIPPED, Clock, clock_of, dataset_outline, opened
from fleetlog.view.fleet import FIELDS, Fleet, curve_style, log_day
from fleetlog.view.ribbons import LOAD_CENTRE, LOAD_HALF, box, mesh3d, truck_body, truck_fork
from fleetlog.view.scene import log_site, log_ways, ways_of
from fleetlog.view.stream import Singles, Stream, Tape, entity, open_stream, ui_points, verbatim

Days: TypeAlias = Iterable[tuple[str, Tape, set[str], list[Floats]]]
ROW_COST = 3e-6  # Of a row that is drawn [s]
RATE = 2.0  # Samples a second that are kept by default
MANY = 60  # From this many vehicles on they are drawn together, one row a time step for all
MANY_LABELS, LONG_LEGEND = 24, 12
_TABLE = tomllib.loads(Path(__file__).with_name("recording.toml").read_text(encoding="utf-8"))
FIGURES, FLEET_CURVES, DIFFERENCES, TOTALS = _TABLE.values()
STEP_RATE = 1.0  # Steps a second of many trucks at most
BLOCK = 400_000  # Positions held in memory at once
MOVING = 0.2
TRAIL_EVERY, MAP_EVERY = 2, 4


def write_recording(
    dataset_path: str | Path, out_rrd: str | Path, *, rate_hz: float = RATE, day: str | None = None
) -> Path:
    """The replay of a dataset, or of one ``day`` (UTC, YYYY-MM-DD), as an .rrd file, whole or not at all.
    ``rate_hz`` samples a second are kept of every vehicle; values are picked, not averaged. The dataset may
    still be the scratch folder of one being written; an older file is replaced."""
    dataset = opened(dataset_path, day)
    site = dataset.site
    screen = blueprint.Screen(dataset_outline(dataset))
    if (span := dataset.span) is not None:
        screen.start, screen.duration = span[0], (span[1] - span[0]) * 1e-6
    if (clock := clock_of(dataset)) is not None:
        screen.timeline, screen.duration = SKIPPED, clock.seconds
    fleet, name = Fleet(dataset, rate_hz), f"{site.name} ({dataset.kind})"
    days = drawn(fleet, screen, clock)
    with open_stream(Path(out_rrd), name, screen.start) as stream:
        stream.clock = clock
        log_site(stream, site)
        periods = [] if clock is None else [*(f"- {line}" for line in clock.lines()), "", ""]
        # The figures of a dataset are of all its days.
        text = "\n".join(periods) + summary_markdown(dataset, figures=day is None)
        stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        log_fleet(stream, screen, fleet, days)
        blueprint.replay(stream, screen, None if site.frame is None else site.frame.latitude)
    return Path(out_rrd)


def drawn(fleet: Fleet, screen: blueprint.Screen, clock: Clock | None = None) -> Days:
    """Every vehicle-day of a fleet of few vehicles, on the engine in use. The workers are there before a
    stream is open: a process must not be forked while Rerun's threads are at work."""
    days = each_day(fleet.dataset, _drawn, fleet, screen.start, clock, cost=ROW_COST)
    first = list(itertools.islice(days, 1 if len(fleet.dataset.vehicles) < MANY else 0))
    return itertools.chain(first, days)


def _drawn(
    _dataset: Dataset, vehicle: str, date: str, fleet: Fleet, start: int | None, clock: Clock | None
) -> tuple[str, Tape, set[str], list[Floats]]:
    """What is sent of one vehicle-day, its signals, and without a map its ways."""
    day, tape, site, lanes = fleet.day(vehicle, date), Tape(), fleet.dataset.site, fleet.lanes(start)
    lane = replace(lanes[fleet.dataset.vehicles.index(vehicle)], last=fleet.last_before(vehicle, date))
    signals = log_day(Stream(tape, clock), lane, day, site, len(lanes) <= MANY_LABELS)
    return vehicle, tape, signals, ways_of(day) if site.network is None else []


def log_fleet(stream: Stream, screen: blueprint.Screen, fleet: Fleet, days: Days) -> None:
    """Every vehicle, day by day, so that memory does not grow with the dataset; what happened to them."""
    dataset, lanes = fleet.dataset, fleet.lanes(screen.start)
    known = events.happenings_of(dataset, fleet.shift)
    if len(lanes) >= MANY:
        screen.signals |= log_together(stream, fleet)
        screen.trails.append(entity(fleet.name, "trail", "fleet"))
        screen.signals |= set() if known is None else events.log_many(stream, known, fleet.name)
        return
    signals, ways = defaultdict[str, set[str]](set), defaultdict[str, list[Floats]](list)
    for vehicle, tape, found, driven in days:
        for name, args, more in tape:
            getattr(stream.recording, name)(*args, **more)
        signals[vehicle] |= found
        ways[vehicle] += driven
    screen.names = tuple(f"{lane.vehicle} {fleet.name}".strip() for lane in lanes)
    screen.legend = len(lanes) <= LONG_LEGEND // len(screen.prefixes) ** 2
    for lane in lanes:
        stream.static(lane.path("trucks", "body"), mesh3d(truck_body(lane.colour)))
        stream.static(lane.path("trucks", "body", "fork"), mesh3d(truck_fork()))
        for signal in sorted(signals[lane.vehicle]):
            stream.static(lane.path(signal), curve_style(f"{lane.vehicle} {fleet.name}".strip(), lane.colour))
        log_ways(stream, lane, ways[lane.vehicle])
        screen.signals |= signals[lane.vehicle]
        screen.trails.append(lane.path("trail"))
    if known is not None and lanes:
        screen.signals |= events.log_events(stream, known, lanes)
        screen.lanes = len(lanes) if "state" in screen.signals else 0


def summary_markdown(dataset: Dataset, figures: bool) -> str:
    """What a dataset says of itself, as Markdown; with the ``figures`` of its import or simulation."""
    meta, edges = dataset.meta, dataset.meta["site"].get("edges", 0)
    known = (meta.get("summary") or {}) if figures else {}
    trucks = len(meta["vehicles"])
    lines = [
        f"**{trucks}** vehicle{'s' if trucks != 1 else ''}, **{dataset.rows:,}** rows, {meta['kind']}",
        f"{' to '.join((meta.get(end) or '-')[:19].replace('T', ' ') for end in ('start', 'end'))} UTC",
        f"{edges} directed road edges" if edges else "no road map",
        *(said.format(factor * known[key]) for key, (said, factor) in FIGURES.items() if known.get(key)),
    ]
    return f"**{verbatim(meta['site']['name'])}**\n\n" + "\n".join(f"- {line}" for line in lines) + "\n"


def log_together(stream: Stream, fleet: Fleet) -> set[str]:
    """The whole fleet, day by day through a scratch file, so that memory does not grow; its signals."""
    centre, half, colour = np.array(LOAD_CENTRE), np.array(LOAD_HALF), fleet.colour or (205, 210, 218)
    load = box((centre - half).tolist(), (centre + half).tolist(), (196, 150, 96))
    for names, archetype in {
        ("trucks", "bodies"): mesh3d([*truck_body(colour), *truck_fork()]),
        ("trucks", "loads"): mesh3d([load]),
        ("trucks", "charge"): rr.Points3D.from_fields(radii=ui_points(3.5)),
        ("trail", "fleet"): rr.Points3D.from_fields(radii=ui_points(1.1), colors=[colour]),
        ("geo", "fleet"): rr.GeoPoints.from_fields(radii=ui_points(3.0), colors=[(86, 180, 233)]),
    }.items():
        stream.static(entity(fleet.name, *names), archetype)
    signals: set[str] = set()
    dataset, vehicles = fleet.dataset, fleet.dataset.vehicles
    rows, step = max(BLOCK // len(vehicles), 1), max(round(1e6 / min(fleet.rate_hz, STEP_RATE)), 1)
    for date in dataset.dates:
        begin = microseconds(date)
        start, end = dataset.span or (begin, begin)
        first, last = max(begin, start), min(begin + DAY - 1, end)
        ticks = np.arange(-(-first // step) * step, last + 1, step, dtype=np.int64)
        with tempfile.TemporaryFile() as scratch:
            for vehicle in vehicles:
                at_steps(dataset.read(vehicle, date, of.COLUMNS), ticks, dataset.site).tofile(scratch)
            for k in range(0, len(ticks), rows):
                # Mapped anew for every block, so that what was read of the file is let go.
                table = np.memmap(scratch, np.float32, "r", shape=(len(vehicles), len(FIELDS), len(ticks)))
                block = np.ascontiguousarray(table[..., k : k + rows].transpose(1, 2, 0))
                values = dict(zip(FIELDS, block, strict=True))
                signals |= _log_block(stream, fleet, ticks[k : k + rows] + fleet.shift, values)
    for signal in signals:
        for curve, (_, tint) in FLEET_CURVES[signal].items():
            title = f"{fleet.name} {'whole fleet' if curve == 'sum' else curve}".strip()
            stream.static(entity(fleet.name, signal, curve), curve_style(title, fleet.colour or tint))
    return signals


def at_steps(t: Trajectory, ticks: Ints, site: Site) -> Singles:
    """(fields, T) the latest row at every tick, NaN where it is older than a gap."""
    out = np.full((len(FIELDS), len(ticks)), np.nan, np.float32)
    rows = np.searchsorted(t.time, ticks, side="right") - 1
    known = np.flatnonzero(rows >= 0)
    known = known[ticks[known] - t.time[rows[known]] <= clock.gap_limit(t.time)]
    for k, name in enumerate(FIELDS):
        out[k, known] = (of.heights(t, site) if name == "z" else t.floats(name))[rows[known]]
    return out


def _log_block(stream: Stream, fleet: Fleet, time: Ints, v: dict[str, Singles]) -> set[str]:
    """A run of time steps (T,) [us], by field a (T, V) array, NaN where a truck is not known; the signals."""
    name, known = fleet.name, np.isfinite(v["x"]) & np.isfinite(v["y"])
    xyz = np.column_stack([v[c][known] for c in "xyz"])
    loaded = known & (np.nan_to_num(v["payload"]) > of.MIN_LOAD)
    lifted = np.column_stack([v[c][loaded] for c in "xyz"])
    lifted[:, 2] += np.nan_to_num(v["fork_height"][loaded])
    for part, here, places in (("bodies", known, xyz), ("loads", loaded, lifted)):
        path, turns = entity(name, "trucks", part), of.quaternions(np.nan_to_num(v["heading"][here]))
        stream.rows(path, time, rr.InstancePoses3D, here.sum(axis=1), translations=places, quaternions=turns)
    path, above = entity(name, "trucks", "charge"), xyz + np.array([0.0, 0.0, 3.0], np.float32)
    colours = palette.soc_colours(v["soc"][known])
    stream.rows(path, time, rr.Points3D, known.sum(axis=1), positions=above, colors=colours)
    moving = (known & ~(v["speed"] <= MOVING))[::TRAIL_EVERY]
    trail = np.column_stack([v[c][::TRAIL_EVERY][moving] for c in "xyz"])
    path, trail = entity(name, "trail", "fleet"), trail + np.array([0.0, 0.0, 0.1], np.float32)
    stream.rows(path, time[::TRAIL_EVERY], rr.Points3D, moving.sum(axis=1), positions=trail)
    if (frame := fleet.dataset.site.frame) is not None:
        seen, path = known[::MAP_EVERY], entity(name, "geo", "fleet")
        where = np.column_stack(frame.to_geographic(*(v[c][::MAP_EVERY][seen] for c in "xy")))
        stream.rows(path, time[::MAP_EVERY], rr.GeoPoints, seen.sum(axis=1), positions=where)
    found = set()
    for column, (signal, factor) in of.CURVES.items():
        shown = known & (v["speed"] > MOVING) if column == "speed" else known
        values = np.where(shown, v[column], np.nan).astype(np.float64) * factor
        if (told := np.isfinite(values).any(axis=1)).any():
            found.add(signal)
            # What the fleet does; NaN at a step at which nothing is known.
            quantiles = [quantile for quantile, _ in FLEET_CURVES[signal].values()]
            curves = np.full((len(quantiles), len(values)), np.nan)
            if signal == "power":
                curves[:, told] = np.nansum(values[told], axis=1)
            else:
                curves[:, told] = np.nanquantile(values[told], quantiles, axis=1)
            for curve, y in zip(FLEET_CURVES[signal], curves, strict=True):
                of.log_curve(stream, entity(name, signal, curve), time, y)
    return found
