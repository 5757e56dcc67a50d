"""KML: tracks with times (``gx:Track``), and placemarks of a point with a ``TimeStamp``.

Lines without times say where, not when: they are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.importers._open import plain_stem
from fleetlog.importers._rows import Rows, finite
from fleetlog.importers._times import iso_time
from fleetlog.importers._xml import Elements, local, nothing_usable, plural
from fleetlog.importers.base import Importer, RawBatch, ReadOptions


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file begins as KML."""
    return b"<kml" in head[:4096]


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a moment of a track, or a placemark with a time."""
    report = options.report
    elements = Elements(path, report, ("Track", "Placemark", "LineString"))
    rows = Rows("latitude", "longitude", share=elements.share)
    vehicle = options.vehicle or plain_stem(path)
    seen: Counter[str] = Counter()
    for tag, element in elements:
        seen[tag] += 1
        if tag == "Track":
            rows.attempt(seen[tag], _track, rows, element, vehicle, seen[tag])
        elif tag == "Placemark":
            rows.attempt(seen[tag], _point, rows, element, vehicle, seen[tag])
        if rows.full:
            yield rows.take()
    if not rows.total:
        what = f"no track with times in it, {plural(seen['LineString'], 'line')} without"
        raise nothing_usable(path, report, what, "export it with times (gx:Track)")
    if seen["LineString"]:
        report.note(f"{plural(seen['LineString'], 'line')} without times left out")
    report.recognised.update(
        {"gx:coord, coordinates": "position, WGS 84, z from m", "when": "timestamp, ISO 8601"}
    )
    yield from rows.drain()


def _track(rows: Rows, element: Any, vehicle: str, record: int) -> None:
    """``when`` and ``coord`` go in pairs; one too many is one rejected record."""
    times = [e.text for e in element if local(e) == "when"]
    spots = [(e.text or "").split() for e in element if local(e) == "coord"]
    for time, spot in zip(times, spots, strict=False):
        _add(rows, vehicle, record, time, spot)
    if len(times) != len(spots):
        rows.reject(record, f"{len(times)} times for {len(spots)} places", "")


def _point(rows: Rows, element: Any, vehicle: str, record: int) -> None:
    when = element.find("{*}TimeStamp/{*}when")
    spot = element.find("{*}Point/{*}coordinates")
    if when is not None and spot is not None:
        _add(rows, vehicle, record, when.text, (spot.text or "").strip().split(","))


def _add(rows: Rows, vehicle: str, record: int, time: str | None, spot: list[str]) -> None:
    numbers = [finite(v) for v in spot[:3]]
    if len(numbers) < 2 or any(v != v for v in numbers[:2]):
        rows.reject(record, "longitude or latitude is not a number", spot)
        return
    values = dict(zip(("longitude", "latitude", "z"), numbers, strict=False))
    try:
        rows.add(vehicle, iso_time(time or ""), record, values)
    except ValueError:
        rows.reject(record, "time is not ISO 8601", time)


IMPORTER = Importer("kml", (".kml",), sniff, read)
