"""GeoJSON (RFC 7946): points with a time, or lines with a time for every vertex.

The times of a line stand in ``coordTimes`` or ``times`` (or below ``coordinateProperties``), one a vertex, as
converters of GPX and Mapbox write them.  Points are read by their properties' names, as a CSV's columns."""

import codecs
import json
import re
from collections.abc import Iterator
from io import BufferedReader
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.words import count
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Fields, Source, fields_of
from fleetlog.importers._rows import Records, finite
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer

TIMES, BLOCK = ("coordTimes", "times", "timestamps"), 1 << 18
FEATURE_LIMIT = 1 << 27  # Characters of one feature that are believed
_OPEN, _BETWEEN = re.compile(r'"features"\s*:\s*\['), re.compile(r"[\s,\[\x1e\ufeff]*")
_SIGN = re.compile(rb'"type"\s*:\s*"(FeatureCollection|Feature)"')


def sniff(path: Path, head: bytes) -> bool:
    """Whether the text begins as a JSON object and speaks of features."""
    return head.lstrip(b"\xef\xbb\xbf\x1e \t\r\n").startswith(b"{") and _SIGN.search(head) is not None


def features(stream: BufferedReader, report: ReadReport) -> Iterator[dict[str, Any]]:
    """Every object of a collection's ``features``, or every one at the top (a single one, or one a line).
    More is read, twice as much each time, until one is whole; ``report`` hears where the text is broken."""
    text_of = codecs.getincrementaldecoder("utf-8-sig")("replace")
    text, size, done, collection = "", BLOCK, 0, None
    while True:
        block = stream.read(size)
        text, size = text + text_of.decode(block, final=not block), 2 * size
        if collection is None:
            collection = _OPEN.search(text)
            text = text[collection.end() :] if collection else text
        at = 0
        for item, end in _objects(text):
            at, done, size = end, done + 1, BLOCK
            yield item
        text = _BETWEEN.sub("", text[at:], count=1)
        if text.startswith("]") or not (block or text or collection):
            return
        if not block or not (text + "{").startswith("{") or len(text) > FEATURE_LIMIT:
            report.damaged(f"the JSON is cut off or wrong in feature {done + 1}")
            return


def _objects(text: str) -> Iterator[tuple[dict[str, Any], int]]:
    """The objects that are whole, each with its end; an integer of hundreds of digits is infinite."""
    decoder = json.JSONDecoder(parse_int=lambda digits: int(digits) if len(digits) < 300 else float(digits))
    at = 0
    while (between := _BETWEEN.match(text, at)) and text[between.end() : between.end() + 1] == "{":
        try:
            item, at = decoder.raw_decode(text, between.end())
        except (ValueError, RecursionError):
            return
        yield item, at


class _GeoJson(Records):
    """One row a point or vertex, in degrees or, where a feature says so, in local metres."""

    places = (GEOGRAPHIC, LOCAL)
    points = 0

    def records(self) -> Iterator[dict[str, Any]]:
        self._fields: dict[tuple[str, ...], Fields] = {}
        return features(self.stream, self.report)

    def take(self, feature: dict[str, Any], number: int) -> None:
        geometry, properties = feature.get("geometry"), feature.get("properties")
        geometry = geometry if isinstance(geometry, dict) else {}
        properties = properties if isinstance(properties, dict) else {}
        kind, coordinates = str(geometry.get("type")), geometry.get("coordinates")
        if kind == "Point":
            self._point(coordinates, properties, number)
        elif kind in ("LineString", "MultiLineString") and isinstance(coordinates, list):
            self._lines([coordinates] if kind == "LineString" else coordinates, properties, number)
        else:
            self.seen[kind] += 1  # Of no use

    def _known(self, properties: dict[str, Any]) -> Fields:
        names = tuple(properties)
        if names not in self._fields:
            if len(self._fields) > 1000:  # every feature with other names: remembering gains nothing
                self._fields.clear()
            given = (n for n in names if n not in ("geometry", "frame"))
            self._fields[names] = fields_of(given, self.options.profile, self.report)
        return self._fields[names]

    def _vehicle(self, known: Fields, properties: dict[str, Any]) -> str:
        name = properties.get(known.vehicle) if known.vehicle else None
        if self.options.vehicle or known.vehicle == "id" or name is None or isinstance(name, dict | list):
            return self.vehicle
        return str(name)

    def _point(self, coordinates: Any, properties: dict[str, Any], number: int) -> None:
        self.points += 1
        known = self._known(properties)
        rows = self.tables[properties.get("frame") == "local metres"]
        values = _place(coordinates, rows.place)
        try:
            time = known.instant(properties.get(known.time[0]) if known.time else None)
        except ValueError:
            rows.reject(number, "point without a time", properties)
            return
        for name, field in known.columns.items():
            values.setdefault(name, _value(field, properties))
        values |= {name: _own(properties[name]) for name in known.kept}
        rows.add(self._vehicle(known, properties), time, number, values, coordinates)

    def _lines(self, lines: list[Any], properties: dict[str, Any], number: int) -> None:
        inner = properties.get("coordinateProperties")
        sources = (properties, inner if isinstance(inner, dict) else {})
        given = (source.get(name) for source in sources for name in TIMES)
        times = next((times for times in given if isinstance(times, list)), [])
        times = [times] if times and not isinstance(times[0], list) else times
        known = self._known({k: v for k, v in properties.items() if not isinstance(v, list | dict)})
        vehicle = self._vehicle(known, properties)
        for line, stamps in zip_longest(lines, times[: len(lines)]):
            if not isinstance(line, list) or not isinstance(stamps, list) or len(stamps) != len(line):
                for vertex in line if isinstance(line, list) else [properties]:
                    self.rows.reject(number, "vertex of a line without a time for each", vertex)
                continue
            for vertex, stamp in zip(line, stamps, strict=True):
                try:
                    time = known.instant(stamp, None)
                except ValueError:
                    self.rows.reject(number, "vertex without a time", f"{vertex} {stamp}")
                else:
                    self.rows.add(vehicle, time, number, _place(vertex, GEOGRAPHIC), vertex)

    def nothing(self) -> tuple[str, str]:
        found = [count(self.points, "point") + " without a time"] if self.points else []
        vertices = self.rows.rejected - self.points
        found += [f"{vertices:,} vertices of lines without times"] if vertices > 0 else []
        found += [f"{n} {kind}" for kind, n in self.seen.items()]
        what = "no position with a time in it" + (f", only {' and '.join(found)}" if found else "")
        return what, "give points a property 'timestamp', lines 'coordTimes'"

    def describe(self) -> None:
        if self.seen:
            kinds = ", ".join(f"{n} {k}" for k, n in self.seen.items())
            self.report.note(f"geometries without motion left out: {kinds}")


def _place(coordinates: Any, pair: tuple[str, ...]) -> dict[str, Any]:
    """A place in degrees stands with the longitude first."""
    given = coordinates if isinstance(coordinates, list) else []
    names = pair if pair == LOCAL else pair[::-1]
    return dict(zip((*names, "z"), map(finite, given), strict=False))


def _value(field: Source, properties: dict[str, Any]) -> Any:
    raw = properties.get(field.column)
    if isinstance(raw, str) and field.unit is None and finite(raw) != finite(raw):
        return raw
    return float(field.to_si(field.known(np.array(finite(raw))))) if raw is not None else None


def _own(value: Any) -> Any:
    """A text or a figure; None for anything else."""
    if isinstance(value, bool):
        return float(value)
    return finite(value) if isinstance(value, int | float) else value if isinstance(value, str) else None


NAMES = (".geojson", ".json", ".geojsonl", ".geojsons")
IMPORTER = Importer("geojson", NAMES, sniff, _GeoJson.batches, rank=2)
