"""Garmin TCX: the trackpoints of all activities and courses, with altitude and speed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.core.words import count
from fleetlog.importers._rows import Rows, finite, gather
from fleetlog.importers._xml import Elements, local
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, holding

_LEAVES = {
    "LatitudeDegrees": "latitude", "LongitudeDegrees": "longitude", "AltitudeMeters": "z", "Speed": "speed",
    "Watts": "watts", "DistanceMeters": "distance",
}  # fmt: skip


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a trackpoint that has a position."""
    report = options.report
    elements = Elements(path, report, ("Trackpoint",), "Track")
    rows = Rows("latitude", "longitude", share=elements.share)
    still: list[int] = []

    def take(point: Any, number: int) -> None:
        if point.find("{*}Position") is None:
            still.append(number)
        else:
            texts = {local(leaf): leaf.text for leaf in point.iter()}
            values = {name: finite(texts[leaf]) for leaf, name in _LEAVES.items() if leaf in texts}
            rows.add_iso(options.name, texts.get("Time"), number, values)

    yield from gather(elements, take, rows)
    if not rows.total:
        points = count(elements.seen["Trackpoint"], "trackpoint")
        what = f"none of its {points} has time and position"
        raise report.nothing(what, "record the activity with its position")
    report.recognised |= {
        "Position": "position, WGS 84", "Time": "timestamp, ISO 8601", "AltitudeMeters": "z, from m",
        "Speed": "speed, from m/s",
    }  # fmt: skip
    if still:
        report.note(f"{count(len(still), 'trackpoint')} without a position left out")
    yield from rows.drain()


IMPORTER = Importer("tcx", (".tcx",), holding(b"<TrainingCenterDatabase"), read)
