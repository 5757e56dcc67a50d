"""GPX 1.0 and 1.1: tracks with times.

Waypoints and routes are no motion and are left out, with a note.  ``speed`` [m/s] and ``course`` [degrees]
may stand in an extension; numbers in other extensions are kept.  A file is one vehicle, named by the file; a
file that fleetlog wrote names its vehicles by its tracks.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.core.columns import BY_NAME
from fleetlog.core.words import count
from fleetlog.importers._open import ReadReport
from fleetlog.importers._rows import Rows, finite, gather, heading_of_course
from fleetlog.importers._xml import Elements, local
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, holding

_KEPT = {"ele": "z", "hdop": "hdop", "sat": "satellites", "speed": "speed", "atemp": "ambient_temperature"}
_COURSES = ("course", "bearing")
_STILL = {"wpt": "waypoint", "rtept": "route point"}


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """The points of all tracks, in the order of the file."""
    elements = Elements(path, options.report, ("trkpt",), "wpt", "rtept", "trkseg", "trk")
    rows = Rows("latitude", "longitude", share=elements.share)
    names: set[str] = set()
    segment, vehicle = None, options.name

    def take(point: Any, number: int) -> None:
        nonlocal segment, vehicle
        if point.getparent() is not segment:
            segment = point.getparent()
            track = segment.getparent().findtext("{*}name", "").strip()
            names.update([track] if track else [])
            ours = (point.getroottree().getroot().get("creator") or "").startswith("fleetlog")
            vehicle = track if track and ours and options.vehicle is None else options.name
        _add_point(rows, point, vehicle, number)

    yield from gather(elements, take, rows)
    if not rows.total:
        raise options.report.nothing(_what_is_there(elements.seen, rows), "record the track with times")
    _describe(options.report, elements.seen, names, options.name)
    yield from rows.drain()


def _add_point(rows: Rows, element: Any, vehicle: str, record: int) -> None:
    values: dict[str, Any] = {"latitude": finite(element.get("lat")), "longitude": finite(element.get("lon"))}
    time = None
    for leaf in element.iterdescendants("{*}*"):
        name = local(leaf)
        if name in _KEPT:
            values[_KEPT[name]] = finite(leaf.text)
        elif name == "time" and leaf.getparent() is element:
            time = leaf.text
        elif name in _COURSES:
            values["heading"] = heading_of_course(finite(leaf.text))
        elif not len(leaf) and leaf.getparent() is not element:
            _keep_extension(values, name, leaf.text)
    rows.add_iso(vehicle, time, record, values, element.attrib)


def _keep_extension(values: dict[str, Any], name: str, text: str | None) -> None:
    number = finite(text)
    if number == number and name not in ("latitude", "longitude"):
        values[name] = number
    elif text and BY_NAME.get(name) is not None and BY_NAME[name].kind == "label":
        values[name] = text


def _what_is_there(seen: Counter[str], rows: Rows) -> str:
    if seen["trkpt"]:
        points = count(seen["trkpt"], "track point")
        return f"none of its {points} can be used: {rows.take().rejects[0].reason}"
    others = [count(seen[t], noun) for t, noun in _STILL.items() if seen[t]]
    return f"no track in it, only {' and '.join(others)}" if others else "no track point in it"


def _describe(report: ReadReport, seen: Counter[str], names: set[str], vehicle: str) -> None:
    report.recognised |= {"lat, lon": "position, WGS 84", "time": "timestamp, ISO 8601", "ele": "z, from m"}
    if len(names) > 1:
        report.note(f"{count(len(names), 'track')} with different names read as vehicle {vehicle}")
    for tag, noun in _STILL.items():
        if seen[tag]:
            report.note(f"{count(seen[tag], noun)} left out: no motion")


IMPORTER = Importer("gpx", (".gpx",), holding(b"<gpx", b"<\x00g\x00p\x00x\x00"), read)
