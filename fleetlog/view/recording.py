"""``recording.rrd``: the replay of a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
SAID = frozenset({"start", "end", "rows", "vehicles", "rejected_file", "damaged"})
"""Keys of a summary that are said already, or mean nothing beside a replay."""
COLUMNS = (
    "x", "y", "z", "heading", "speed", "edge_id", "edge_offset", "payload", "fork_height", "battery_power",
    "soc",
)  # fmt: skip


def write_recording(
    dataset_path: str | Path,
    out_rrd: str | Path,
    *,
    rate_hz: float = RATE,
    summary: str | Mapping[str, Any] | None = None,
    day: str | None = None,
) -> Path:
    """The replay of a dataset as an .rrd file that opens with everything in view.

    Parameters
    ----------
    dataset_path : folder of the dataset; it may still be the scratch folder of one being written.
    out_rrd : the file; it appears whole or not at all, and replaces an older one.
    rate_hz : samples a second kept of every vehicle; values are picked, not averaged.
    summary : Markdown, or figures by name, shown beside the replay; by default the dataset's own.
    day : show the rows of this day (UTC, YYYY-MM-DD) alone.
    """
    dataset = opened(dataset_path, day)
    if day is not None and summary is None:
        summary = {}  # that of the dataset is of all its days
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
        log_summary(stream, dataset, summary)
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


def log_summary(stream: Stream, dataset: Dataset, summary: str | Mapping[str, Any] | None) -> None:
    """The summary as a text beside the views."""
    text = summary if isinstance(summary, str) else summary_markdown(dataset, summary)
    if stream.clock is not None:
        text = "\n".join(f"- {line}" for line in stream.clock.lines()) + f"\n\n{text}"
    stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def summary_markdown(dataset: Dataset, figures: Mapping[str, Any] | None = None) -> str:
    """What a dataset says of itself, as Markdown."""
    meta, edges = dataset.meta, dataset.meta["site"].get("edges", 0)
    trucks = len(meta["vehicles"])
    head = [
        f"**{trucks}** vehicle{'s' if trucks != 1 else ''}, **{dataset.rows:,}** rows, {meta['kind']}",
        f"{_clock(meta.get('start'))} to {_clock(meta.get('end'))} UTC",
        f"{edges} directed road edges" if edges else "no road map",
    ]
    more = summary_lines(meta.get("summary") or {} if figures is None else figures)
    lines = "\n".join(f"- {line}" for line in [*head, *more])
    return f"**{verbatim(meta['site']['name'])}**\n\n{lines}\n"


def summary_lines(figures: Mapping[str, Any]) -> list[str]:
    """The figures of an import or a simulation that say something beside the dataset's own, one a line."""
    lines = []
    for key, value in figures.items():
        name = verbatim(str(key).replace("_", " "))
        if key in SAID or value in (None, "", 0, [], {}):
            continue
        if key == "files" and isinstance(value, list):
            kinds = Counter(str(f.get("format")) for f in value)
            lines.append("files: " + ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items())))
        elif isinstance(value, str | int | float):
            lines.append(f"{name}: {_figure(value)}")
        elif isinstance(value, Mapping) and all(isinstance(v, str | int | float) for v in value.values()):
            parts = ", ".join(f"{verbatim(str(k))} {_figure(v)}" for k, v in value.items())
            lines.append(f"{name}: {parts}")
    return lines


def _clock(iso: str | None) -> str:
    return "-" if iso is None else iso.removesuffix("Z")[:19].replace("T", " ")


def _figure(value: Any) -> str:
    if isinstance(value, bool | str):
        return verbatim(str(value))
    if isinstance(value, float) and 0.0 < value <= 1.0:
        return f"{100.0 * value:.4g} %"
    return f"{value:,}" if isinstance(value, int) else f"{value:,.4g}"
