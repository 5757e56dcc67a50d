"""Garmin TCX: the trackpoints of all activities and courses, with altitude and speed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.importers._open import plain_stem
from fleetlog.importers._rows import Rows, finite
from fleetlog.importers._times import iso_time
from fleetlog.importers._xml import Elements, local, nothing_usable, plural
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

_LEAVES = {
    "LatitudeDegrees": "latitude", "LongitudeDegrees": "longitude", "AltitudeMeters": "z", "Speed": "speed",
    "Watts": "watts", "DistanceMeters": "distance",
}  # fmt: skip


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file begins as TCX."""
    return b"<TrainingCenterDatabase" in head[:4096]


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a trackpoint that has a position."""
    report = options.report
    elements = Elements(path, report, ("Trackpoint", "Track"))
    rows = Rows("latitude", "longitude", share=elements.share)
    vehicle = options.vehicle or plain_stem(path)
    number = unplaced = 0
    for tag, element in elements:
        if tag != "Trackpoint":
            continue
        number += 1
        if element.find("{*}Position") is None:
            unplaced += 1
            continue
        rows.attempt(number, _add, rows, element, vehicle, number)
        if rows.full:
            yield rows.take()
    if not rows.total:
        raise nothing_usable(path, report, f"none of its {plural(number, 'trackpoint')} has time and position",
                             "record the activity with its position")  # fmt: skip
    report.recognised.update({
        "Position": "position, WGS 84", "Time": "timestamp, ISO 8601", "AltitudeMeters": "z, from m",
        "Speed": "speed, from m/s",
    })  # fmt: skip
    if unplaced:
        report.note(f"{plural(unplaced, 'trackpoint')} without a position left out")
    yield from rows.drain()


def _add(rows: Rows, element: Any, vehicle: str, number: int) -> None:
    time, values = None, {}
    for leaf in element.iter():
        name = local(leaf)
        if name == "Time":
            time = leaf.text
        elif name in _LEAVES:
            values[_LEAVES[name]] = finite(leaf.text)
    if not all(values.get(n, float("nan")) == values.get(n) for n in ("latitude", "longitude")):
        rows.reject(number, "latitude or longitude is not a number", values)
        return
    try:
        rows.add(vehicle, iso_time(time or ""), number, values)
    except ValueError:
        rows.reject(number, "time is not ISO 8601", time)


IMPORTER = Importer("tcx", (".tcx",), sniff, read)
