"""``recording.rrd``: the replay of a dataset."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import rerun as rr

from fleetlog.core.trajectory import Floats, Trajectory
from fleetlog.store import Dataset
from fleetlog.view import blueprint, events, fleet, palette, thin
from fleetlog.view.clock import SKIPPED, clock_of
from fleetlog.view.day import opened
from fleetlog.view.extent import dataset_outline
from fleetlog.view.happenings import happenings_of
from fleetlog.view.palette import Colour
from fleetlog.view.scene import log_site, log_ways, ways_of
from fleetlog.view.stream import Stream, entity, microseconds, open_stream, verbatim

RATE = 2.0
"""Samples a second that are kept by default."""
MANY = 60
"""From this many vehicles on they are drawn together, one row a time step for all."""
MANY_RATE = 1.0
"""Steps a second at most when they are."""
MANY_LABELS, LONG_LEGEND = 24, 12
FIGURES: dict[str, tuple[str, float]] = {
    "trips": ("trips: {:,.0f}", 1.0), "matched": ("on a road: {:.1f} % of the rows", 100.0),
    "rows_rejected": ("rows rejected: {:,.0f}", 1.0), "tasks_done": ("tasks done: {:,.0f}", 1.0),
    "distance_m": ("driven: {:,.1f} km", 1e-3), "energy_wh": ("energy: {:,.1f} kWh", 1e-3),
    "soc_lowest": ("lowest state of charge: {:.0f} %", 100.0),
    "waiting_s": ("waiting: {:,.1f} h", 1.0 / 3600.0),
}  # fmt: skip
"""Figures of an import or a simulation that are shown, with the factor to the unit in which they are."""
COLUMNS = (
    "x", "y", "z", "heading", "speed", "edge_id", "edge_offset", "payload", "fork_height", "battery_power",
    "soc",
)  # fmt: skip


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
    start, end = (microseconds(dataset.meta.get(k)) for k in ("start", "end"))
    duration = 0.0 if start is None or end is None else (end - start) * 1e-6
    screen = blueprint.Screen(
        dataset_outline(dataset), on_earth=site.frame is not None, start=start, duration=duration
    )
    with open_stream(Path(out_rrd), f"{site.name} ({dataset.kind})", start) as stream:
        if (clock := clock_of(dataset)) is not None:
            stream.clock, screen.timeline, screen.duration = clock, SKIPPED, clock.seconds
        log_site(stream, site)
        # The figures of a dataset are of all its days.
        log_summary(stream, dataset, figures=day is None)
        Fleet(dataset, rate_hz).log(stream, screen)
        latitude = None if site.frame is None else site.frame.latitude
        blueprint.send(stream, blueprint.replay(screen, latitude))
    return Path(out_rrd)


@dataclass(frozen=True)
class Fleet:
    """One dataset in a recording: path, colour and name of its entities, and how its clock is moved [us]."""

    dataset: Dataset
    rate_hz: float
    prefix: str = ""
    colour: Colour | None = None
    name: str = ""
    shift: int = 0

    def log(self, stream: Stream, screen: blueprint.Screen) -> None:
        """Every vehicle, day by day, so that memory does not grow with the dataset."""
        if len(self.dataset.vehicles) >= MANY:
            self._log_together(stream, screen)
            return
        labels = len(self.dataset.vehicles) <= MANY_LABELS
        screen.legend = len(self.dataset.vehicles) <= LONG_LEGEND // len(screen.prefixes) ** 2
        for number, vehicle in enumerate(self.dataset.vehicles):
            lane = fleet.Lane(vehicle, self._colour(number), self.prefix, self.name, screen.start)
            signals: set[str] = set()
            ways: list[Floats] = []
            for day in self.days(vehicle):
                ways += ways_of(day) if self.dataset.site.network is None else []
                signals |= fleet.log_day(stream, lane, day, self.dataset.site, labels)
            fleet.log_static(stream, lane, signals)
            log_ways(stream, self.prefix, vehicle, lane.colour, ways, self.dataset.site)
            screen.signals |= signals
            screen.trails.append(lane.path("trail"))
        if (known := happenings_of(self.dataset, self.shift)) is not None:
            names = self.dataset.vehicles
            colours = [self._colour(number) for number in range(len(names))]
            screen.signals |= events.log_events(stream, known, names, colours, self.prefix, self.name)
            screen.lanes = len(names) if "state" in screen.signals else 0

    def days(self, vehicle: str) -> Iterator[Trajectory]:
        """The thinned days of a vehicle on the recording's clock."""
        for date in self.dataset.dates:
            day = self.dataset.read(vehicle, date, COLUMNS)
            if len(day):
                kept = thin.thinned(day, self.rate_hz)
                yield Trajectory(vehicle, kept.time + self.shift, kept.columns)

    def _colour(self, number: int) -> Colour:
        return palette.vehicle_colour(number) if self.colour is None else palette.shade(self.colour, number)

    def _log_together(self, stream: Stream, screen: blueprint.Screen) -> None:
        from fleetlog.view import batch

        screen.signals |= batch.log_fleet(
            stream, self.dataset, COLUMNS, rate_hz=min(self.rate_hz, MANY_RATE),
            prefix=self.prefix, colour=self.colour or (205, 210, 218), shift=self.shift, name=self.name,
        )  # fmt: skip
        screen.trails.append(entity(self.prefix, "trail", "fleet"))
        if (known := happenings_of(self.dataset, self.shift)) is not None:
            screen.signals |= events.log_many(stream, known, self.prefix, self.name)


def log_summary(stream: Stream, dataset: Dataset, figures: bool) -> None:
    """The summary as a text beside the views."""
    text = summary_markdown(dataset, figures)
    if stream.clock is not None:
        text = "\n".join(f"- {line}" for line in stream.clock.lines()) + f"\n\n{text}"
    stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def summary_markdown(dataset: Dataset, figures: bool) -> str:
    """What a dataset says of itself, as Markdown; with the ``figures`` of its import or simulation."""
    meta, edges = dataset.meta, dataset.meta["site"].get("edges", 0)
    known = (meta.get("summary") or {}) if figures else {}
    trucks = len(meta["vehicles"])
    lines = [
        f"**{trucks}** vehicle{'s' if trucks != 1 else ''}, **{dataset.rows:,}** rows, {meta['kind']}",
        f"{_clock(meta.get('start'))} to {_clock(meta.get('end'))} UTC",
        f"{edges} directed road edges" if edges else "no road map",
        *(said.format(factor * known[key]) for key, (said, factor) in FIGURES.items() if known.get(key)),
    ]
    return f"**{verbatim(meta['site']['name'])}**\n\n" + "\n".join(f"- {line}" for line in lines) + "\n"


def _clock(iso: str | None) -> str:
    return "-" if iso is None else iso.removesuffix("Z")[:19].replace("T", " ")
