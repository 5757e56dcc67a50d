"""GPX 1.0 and 1.1: tracks with times.

Waypoints and routes are no motion and are left out, aloud.  ``speed`` [m/s] and ``course`` [degrees] are read
where GPX 1.0 has them or an extension of 1.1 does; numbers in other extensions are kept under their own
names.  A file of one receiver is one vehicle, named by the file; a file that fleetlog wrote names its
vehicles by its tracks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.core.columns import BY_NAME
from fleetlog.importers._open import plain_stem, plural
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import Rows, finite, heading_of_course
from fleetlog.importers._times import iso_time
from fleetlog.importers._xml import Elements, local, nothing_usable
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

_KEPT = {"hdop": "hdop", "sat": "satellites", "speed": "speed", "atemp": "ambient_temperature"}
_COURSES = ("course", "bearing")


def sniff(path: Path, head: bytes) -> bool:
    """Whether the file begins as GPX."""
    return b"<gpx" in head[:4096] or b"<\x00g\x00p\x00x\x00" in head[:4096]


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """The points of all tracks, in the order of the file."""
    report = options.report
    elements = Elements(path, report, ("trkpt", "wpt", "rtept", "trkseg", "trk"))
    rows = Rows("latitude", "longitude", share=elements.share)
    seen: Counter[str] = Counter()
    names: set[str] = set()
    unnamed = options.vehicle or plain_stem(path)
    for tag, element in elements:
        seen[tag] += 1
        if tag != "trkpt":
            continue
        track = _track_name(element)
        if track:
            names.add(track)
        ours = options.vehicle is None and track and _ours(element)
        rows.attempt(seen["trkpt"], _add_point, rows, element, str(track) if ours else unnamed, seen["trkpt"])
        if rows.full:
            yield rows.take()
    if not rows.total:
        raise nothing_usable(path, report, _what_is_there(seen, rows), "record the track with times")
    _describe(report, seen, names, unnamed)
    yield from rows.drain()


def _add_point(rows: Rows, element: Any, vehicle: str, record: int) -> None:
    latitude, longitude = finite(element.get("lat")), finite(element.get("lon"))
    values: dict[str, Any] = {"latitude": latitude, "longitude": longitude}
    time = None
    for leaf in element.iter():
        if len(leaf) or not isinstance(leaf.tag, str):
            continue
        name = local(leaf)
        if name == "time" and leaf.getparent() is element:
            time = leaf.text
        elif name == "ele":
            values["z"] = finite(leaf.text)
        elif name in _COURSES:
            values["heading"] = heading_of_course(finite(leaf.text))
        elif name in _KEPT:
            values[_KEPT[name]] = finite(leaf.text)
        elif local(leaf.getparent()) != "trkpt":
            _keep_extension(values, name, leaf.text)
    if latitude != latitude or longitude != longitude:
        rows.reject(record, "latitude or longitude is not a number", dict(element.attrib))
    elif not time:
        rows.reject(record, "point without a time", f"{latitude} {longitude}")
    else:
        try:
            rows.add(vehicle, iso_time(time), record, values)
        except ValueError:
            rows.reject(record, "time is not ISO 8601", time)


def _keep_extension(values: dict[str, Any], name: str, text: str | None) -> None:
    number = finite(text)
    if number == number and name not in ("latitude", "longitude"):
        values[name] = number
    elif text and BY_NAME.get(name) is not None and BY_NAME[name].kind == "label":
        values[name] = text


def _track_name(point: Any) -> str | None:
    segment = point.getparent()
    track = segment.getparent() if segment is not None else None
    name = track.find("{*}name") if track is not None else None
    return name.text.strip() if name is not None and name.text else None


def _ours(point: Any) -> bool:
    return str(point.getroottree().getroot().get("creator", "")).startswith("fleetlog")


def _what_is_there(seen: Counter[str], rows: Rows) -> str:
    if seen["trkpt"]:
        return (
            f"none of its {plural(seen['trkpt'], 'track point')} can be used: {rows.take().rejects[0].reason}"
        )
    others = [plural(seen[t], noun) for t, noun in (("wpt", "waypoint"), ("rtept", "route point")) if seen[t]]
    return f"no track in it, only {' and '.join(others)}" if others else "no track point in it"


def _describe(report: ReadReport, seen: Counter[str], names: set[str], vehicle: str) -> None:
    report.recognised.update(
        {"lat, lon": "position, WGS 84", "time": "timestamp, ISO 8601", "ele": "z, from m"}
    )
    if len(names) > 1:
        report.note(f"{plural(len(names), 'track')} with different names read as vehicle {vehicle}")
    for tag, noun in (("wpt", "waypoint"), ("rtept", "route point")):
        if seen[tag]:
            report.note(f"{plural(seen[tag], noun)} left out: no motion")


IMPORTER = Importer("gpx", (".gpx",), sniff, read)
