"""Logs to a dataset, in seven steps: find, read, order, set down, clean, match, write.

Everything read is set down by vehicle and day first (:mod:`fleetlog.ingest.spill`); then one vehicle after
the other is cleaned,
placed, matched and written, stretch by stretch, so that memory is bounded by a stretch whatever the size of
the logs.
A stretch ends where a trip begins, so that no trip is torn and matching starts at a standstill.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.site import MapFrame, Site
from fleetlog.errors import FleetlogError, InputError
from fleetlog.importers._profile import Profile, load_profile
from fleetlog.ingest.clean import sort_rows
from fleetlog.ingest.files import Log, find_logs
from fleetlog.ingest.reading import Reading
from fleetlog.ingest.spill import Spill
from fleetlog.ingest.stretch import VehicleImport
from fleetlog.ingest.summary import ImportSummary
from fleetlog.store.provenance import provenance

if TYPE_CHECKING:
    from fleetlog.store.writer import DatasetWriter

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of all that is done, 0 to 1."""
READ_SHARE = 0.5
ALIGN_VEHICLES = 20
"""Vehicles whose tracks are fitted to the roads."""


def import_logs(
    paths: Sequence[str | Path],
    site: Site | None,
    writer: DatasetWriter,
    *,
    format: str | None = None,
    profile: str | Path | Profile | None = None,
    progress: Progress | None = None,
    align: bool = False,
) -> ImportSummary:
    """Read ``paths`` (files, folders, patterns) and write their rows through ``writer``.

    ``site`` is None where there is no map: then the frame comes from the data.  The writer's site,
    provenance and summary are
    set; its ``finish`` is left to the caller.  ``align`` fits the frame of local positions to the roads of
    ``site``.  :class:`~fleetlog.errors.InputError` where nothing usable was
    found.
    """
    profile = load_profile(profile) if isinstance(profile, str | Path) else profile
    logs = find_logs(paths, format)
    spill = Spill(writer.path / ".spill")
    try:
        reading = Reading(spill, writer.path, logs, profile)
        for i, log in enumerate(logs):
            _read(reading, i, log, len(logs), progress)
        _check_read(reading, logs)
        site = replace(site or Site(), map_frames=(*(site or Site()).map_frames, *_frames(profile)))
        every = _aligned(reading, site) if align else _only(profile)
        summary = _write(reading, site, writer, progress, every)
    finally:
        spill.clear()
    inputs = [f for log in logs for f in ([log.path] if log.path.is_file() else sorted(log.path.rglob("*")))]
    if profile is not None and profile.path:
        inputs.append(Path(profile.path))
    writer.provenance = provenance(inputs)
    writer.summary = summary.to_dict()
    return summary


def _read(reading: Reading, number: int, log: Log, count: int, progress: Progress | None) -> None:
    def tell(share: float) -> None:
        if progress:
            progress(f"reading {log.path.name}", READ_SHARE * (number + share) / count)

    try:
        reading.read(number, log, tell)
    except FleetlogError as error:
        if count == 1:
            raise
        reading.failed(number, log, error)


def _check_read(reading: Reading, logs: list[Log]) -> None:
    """One clear line where there is nothing to go on with."""
    if reading.positioned:
        return
    where = logs[0].path if len(logs) == 1 else f"{logs[0].path} and {len(logs) - 1} more"
    first = next((error for error in reading.errors if error is not None), None)
    if first is not None and not reading.spill.rows:
        raise first
    if reading.spill.rows:
        raise InputError(
            "no position in the log", where=where, do="map latitude and longitude, or x and y, in a profile"
        )
    refused = ", ".join(f"{n:,}: {reason}" for reason, n in reading.rejects.rows.most_common(3))
    raise InputError(
        f"no usable row in the log{f' (refused {refused})' if refused else ''}",
        where=where,
        do="see docs/logs.md",
    )


def _frames(profile: Profile | None) -> tuple[MapFrame, ...]:
    return profile.map_frames if profile is not None else ()


def _only(profile: Profile | None) -> MapFrame | None:
    """The frame of all rows: that of a profile which states just one."""
    frames = _frames(profile)
    return frames[0] if len(frames) == 1 else None


def _aligned(reading: Reading, site: Site) -> MapFrame:
    """The frame of the log, fitted to the roads."""
    from fleetlog.ingest.align import align

    tracks = []
    for vehicle in reading.spill.vehicles[:ALIGN_VEHICLES]:
        for rows, _ in itertools.islice(reading.spill.windows(vehicle), 1):
            if "latitude" in rows:
                raise InputError("the log is geographic: it needs no alignment", do="leave --align out")
            rows = sort_rows(rows)
            tracks.append((rows.floats("x"), rows.floats("y")))
    found = align(tracks, site.roads())
    reading.summary.alignment = found.to_dict()
    reading.summary.notes.append(found.line())
    return found.frame


def _write(
    reading: Reading, site: Site, writer: DatasetWriter, progress: Progress | None, every: MapFrame | None
) -> ImportSummary:
    from fleetlog.ingest.place import check_matched, with_frame

    summary = reading.summary
    vehicles = reading.spill.vehicles
    total, done = max(reading.spill.rows, 1), 0
    work: VehicleImport | None = None
    for vehicle in vehicles:
        if vehicle not in reading.positioned:
            for rows, _ in reading.spill.windows(vehicle):
                reading.rejects.refuse(
                    rows, np.ones(len(rows), bool), "no log has a position of this vehicle"
                )
            continue
        for rows, last in reading.spill.windows(vehicle):
            if work is None:
                writer.site = site = with_frame(site, rows)
                work = VehicleImport(site, writer, reading.rejects, summary, reading.spill.own, every)
            work.take(rows, last=last)
            done += len(rows)
            if progress:
                progress(f"matching and writing {vehicle}", READ_SHARE + (1 - READ_SHARE) * done / total)
    reading.rejects.close()
    if work is not None:
        work.end()
        check_matched(summary.matched, summary.rows, site)
    summary.rejected, summary.rejected_values = dict(reading.rejects.rows), dict(reading.rejects.values)
    summary.rejected_file = "rejected.parquet" if reading.rejects.any else None
    if not summary.rows:
        raise InputError(
            "every row was refused", do=", ".join(f"{n:,}: {r}" for r, n in summary.rejected.items())
        )
    return summary
