"""KML: tracks with times (``gx:Track``), and placemarks of a point with a ``TimeStamp``.

Lines without times say where, not when: they are left out.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.core.words import count
from fleetlog.importers._rows import Rows, finite, gather
from fleetlog.importers._xml import Elements, local
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, holding


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a moment of a track, or a placemark with a time; records count each kind."""
    report = options.report
    elements = Elements(path, report, ("Track", "Placemark"), "LineString")
    rows = Rows("latitude", "longitude", share=elements.share)

    def take(element: Any, _: int) -> None:
        tag = local(element)
        (_track if tag == "Track" else _point)(rows, element, options.name, elements.seen[tag])

    yield from gather(elements, take, rows)
    lines = count(elements.seen["LineString"], "line")
    if not rows.total:
        raise report.nothing(f"no track with times in it, {lines} without", "export it with times (gx:Track)")
    if elements.seen["LineString"]:
        report.note(f"{lines} without times left out")
    report.recognised["gx:coord, coordinates"] = "position, WGS 84, z from m"
    report.recognised["when"] = "timestamp, ISO 8601"
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
    values = dict(zip(("longitude", "latitude", "z"), map(finite, spot), strict=False))
    rows.add_iso(vehicle, time, record, values, spot)


IMPORTER = Importer("kml", (".kml",), holding(b"<kml"), read)
