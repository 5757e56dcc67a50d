"""``recording.rrd``: the replay of a dataset."""

from pathlib import Path

import rerun as rr

from fleetlog.core.arrays import Floats
from fleetlog.store import Dataset
from fleetlog.view import batch, blueprint, events
from fleetlog.view.clock import SKIPPED, clock_of, opened, span_of
from fleetlog.view.extent import dataset_outline
from fleetlog.view.fleet import Fleet, curve_style, log_day
from fleetlog.view.ribbons import mesh3d, truck_body, truck_fork
from fleetlog.view.scene import log_site, log_ways, ways_of
from fleetlog.view.stream import Stream, entity, open_stream, verbatim

RATE = 2.0  # Samples a second that are kept by default
MANY = 60  # From this many vehicles on they are drawn together, one row a time step for all
MANY_LABELS, LONG_LEGEND = 24, 12
FIGURES: dict[str, tuple[str, float]] = {
    "trips": ("trips: {:,.0f}", 1.0), "matched": ("on a road: {:.1f} % of the rows", 100.0),
    "rows_rejected": ("rows rejected: {:,.0f}", 1.0), "tasks_done": ("tasks done: {:,.0f}", 1.0),
    "distance_m": ("driven: {:,.1f} km", 1e-3), "energy_wh": ("energy: {:,.1f} kWh", 1e-3),
    "soc_lowest": ("lowest state of charge: {:.0f} %", 100.0),
    "waiting_s": ("waiting: {:,.1f} h", 1.0 / 3600.0),
}  # fmt: skip
"""Figures of an import or a simulation that are shown, with the factor to the unit in which they are."""


def write_recording(
    dataset_path: str | Path, out_rrd: str | Path, *, rate_hz: float = RATE, day: str | None = None
) -> Path:
    """The replay of a dataset as an .rrd file that opens with everything in view.

    Parameters
    ----------
    dataset_path : folder of the dataset; it may still be the scratch folder of one being written.
    out_rrd : the file; it appears whole or not at all, and replaces an older one.
    rate_hz : samples a second kept of every vehicle; values are picked, not averaged.
    day : show the rows of this day (UTC, YYYY-MM-DD) alone.
    """
    dataset = opened(dataset_path, day)
    site = dataset.site
    screen = blueprint.Screen(dataset_outline(dataset))
    if (span := span_of(dataset)) is not None:
        screen.start, screen.duration = span[0], (span[1] - span[0]) * 1e-6
    with open_stream(Path(out_rrd), f"{site.name} ({dataset.kind})", screen.start) as stream:
        if (clock := clock_of(dataset)) is not None:
            stream.clock, screen.timeline, screen.duration = clock, SKIPPED, clock.seconds
        log_site(stream, site)
        periods = [] if clock is None else [*(f"- {line}" for line in clock.lines()), "", ""]
        # The figures of a dataset are of all its days.
        text = "\n".join(periods) + summary_markdown(dataset, figures=day is None)
        stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        log_fleet(stream, screen, Fleet(dataset, rate_hz))
        latitude = None if site.frame is None else site.frame.latitude
        blueprint.send(stream, blueprint.replay(screen, latitude))
    return Path(out_rrd)


def log_fleet(stream: Stream, screen: blueprint.Screen, fleet: Fleet) -> None:
    """Every vehicle, day by day, so that memory does not grow with the dataset; what happened to them."""
    dataset, lanes, prefix = fleet.dataset, fleet.lanes(screen.start), fleet.prefix
    known = events.happenings_of(dataset, fleet.shift)
    if len(lanes) >= MANY:
        screen.signals |= batch.log_together(stream, fleet)
        screen.trails.append(entity(prefix, "trail", "fleet"))
        screen.signals |= set() if known is None else events.log_many(stream, known, prefix, fleet.name)
        return
    screen.legend = len(lanes) <= LONG_LEGEND // len(screen.prefixes) ** 2
    for lane in lanes:
        signals: set[str] = set()
        ways: list[Floats] = []
        for day in fleet.days(lane.vehicle):
            ways += ways_of(day) if dataset.site.network is None else []
            signals |= log_day(stream, lane, day, dataset.site, len(lanes) <= MANY_LABELS)
        stream.static(lane.path("trucks", "body"), mesh3d(truck_body(lane.colour)))
        stream.static(lane.path("trucks", "body", "fork"), mesh3d(truck_fork()))
        for signal in sorted(signals):
            stream.static(lane.path(signal), curve_style(f"{lane.vehicle} {fleet.name}".strip(), lane.colour))
        log_ways(stream, prefix, lane.vehicle, lane.colour, ways, dataset.site)
        screen.signals |= signals
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
