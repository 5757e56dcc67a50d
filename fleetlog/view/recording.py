"""``recording.rrd``: the replay of a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from fleetlog.core.site import Site
from fleetlog.store import Dataset
from fleetlog.store.atomic import atomic_output
from fleetlog.view import blueprint, fleet, palette, thin
from fleetlog.view.extent import dataset_extent
from fleetlog.view.scene import log_site
from fleetlog.view.stream import Stream, open_stream

RATE = 2.0
"""Samples a second that are kept by default."""
MANY = 60
"""From this many vehicles on they are drawn together, one row a time step for all."""
MANY_LABELS = 24
COLUMNS = (
    "x", "y", "z", "heading", "speed", "edge_id", "edge_offset", "payload", "fork_height", "battery_power", "soc",
)  # fmt: skip


def microseconds(iso: str | None) -> int | None:
    """Of the description's times."""
    return None if iso is None else int(np.datetime64(iso.removesuffix("Z"), "us").astype(np.int64))


def write_recording(
    dataset_path: str | Path,
    out_rrd: str | Path,
    *,
    rate_hz: float = RATE,
    summary: str | Mapping[str, Any] | None = None,
) -> Path:
    """The replay of a dataset as an .rrd file that opens with everything in view.

    Parameters
    ----------
    dataset_path : folder of the dataset; it may still be the scratch folder of one being written.
    out_rrd : the file; it appears whole or not at all, and replaces an older one.
    rate_hz : samples a second kept of every vehicle; values are picked, not averaged.
    summary : Markdown, or figures by name, shown beside the replay; by default what the dataset says of itself.
    """
    dataset = Dataset(dataset_path)
    site = dataset.site
    with atomic_output(out_rrd, overwrite=True, folder=False) as scratch:
        start, end = (microseconds(dataset.meta.get(k)) for k in ("start", "end"))
        screen = blueprint.Screen(extent=dataset_extent(dataset), on_earth=site.frame is not None)
        screen.start, screen.duration = start, 0.0 if start is None or end is None else (end - start) * 1e-6
        with open_stream(scratch, f"{site.name} ({dataset.kind})", start) as stream:
            log_site(stream, site)
            log_summary(stream, dataset, summary)
            log_fleet(stream, dataset, site, screen, rate_hz)
            latitude = None if site.frame is None else site.frame.latitude
            blueprint.send(stream, blueprint.replay(screen, latitude))
    return Path(out_rrd)


def log_fleet(stream: Stream, dataset: Dataset, site: Site, screen: blueprint.Screen, rate_hz: float) -> None:
    """Every vehicle, day by day, so that memory does not grow with the dataset."""
    labels = len(dataset.vehicles) <= MANY_LABELS
    for number, vehicle in enumerate(dataset.vehicles):
        lane = fleet.Lane(vehicle, palette.vehicle_colour(number), origin=screen.start)
        signals: set[str] = set()
        for date in dataset.dates:
            day = dataset.read(vehicle, date, COLUMNS)
            if len(day):
                signals |= fleet.log_day(stream, lane, thin.thinned(day, rate_hz), site, labels)
        fleet.log_static(stream, lane, signals)
        screen.signals |= signals
        screen.trails.append(lane.path("trail"))


def log_summary(stream: Stream, dataset: Dataset, summary: str | Mapping[str, Any] | None) -> None:
    """The summary as a text beside the views."""
    text = summary if isinstance(summary, str) else summary_markdown(dataset, summary)
    stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def summary_markdown(dataset: Dataset, figures: Mapping[str, Any] | None = None) -> str:
    """What a dataset says of itself, as Markdown."""
    meta, edges = dataset.meta, dataset.meta["site"].get("edges", 0)
    count = len(meta["vehicles"])
    head = [
        f"**{count}** vehicle{'s' if count != 1 else ''}, **{dataset.rows:,}** rows, {meta['kind']}",
        f"{_clock(meta.get('start'))} to {_clock(meta.get('end'))} UTC",
        f"{edges} directed road edges" if edges else "no road map",
    ]
    more = [
        f"{key.replace('_', ' ')}: {_figure(value)}"
        for key, value in (figures or meta.get("summary") or {}).items()
        if isinstance(value, str | int | float)
    ]
    return f"**{meta['site']['name']}**\n\n" + "\n".join(f"- {line}" for line in [*head, *more]) + "\n"


def _clock(iso: str | None) -> str:
    return "-" if iso is None else iso.removesuffix("Z")[:19].replace("T", " ")


def _figure(value: Any) -> str:
    if isinstance(value, bool | str):
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:,.4g}"
