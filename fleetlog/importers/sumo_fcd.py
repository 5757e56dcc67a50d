"""SUMO's floating car data (``--fcd-output``), XML: every vehicle at every step.

``angle`` is clockwise from north [degrees]; ``x, y`` are metres of the network, or degrees where SUMO was run
with ``--fcd-output.geo``. ``time`` counts seconds from the start of the simulation, so it is placed at the
epoch that the file names (fleetlog's exporter writes it) or at 1970.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.importers._open import HEAD, head_of
from fleetlog.importers._rows import Rows, finite, gather, heading_of_course
from fleetlog.importers._times import iso_time
from fleetlog.importers._xml import Elements
from fleetlog.importers.base import GEOGRAPHIC, LOCAL, Importer, RawBatch, ReadOptions, holding

_EPOCH = re.compile(rb"fleetlog-epoch ([0-9T:.Z+-]{10,40})")
_KNOWN = ("id", "x", "y", "angle")


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a vehicle and step."""
    report, origin = options.report, options.origin or _origin(_EPOCH.search(head_of(path, 4096)))
    elements = Elements(path, report, ("vehicle",), "person", "timestep")
    degrees, metres = (Rows(*pair, share=elements.share) for pair in (GEOGRAPHIC, LOCAL))
    geographic: list[bool] = []

    def take(vehicle: Any, number: int) -> None:
        if not geographic:
            geographic.append(_degrees(vehicle))
        _add(degrees if geographic[0] else metres, vehicle, number, origin, geographic[0])

    yield from gather(elements, take, metres, degrees)
    if not degrees.total + metres.total:
        raise report.nothing("no vehicle with a position in it", "write it with --fcd-output")
    report.recognised |= {"x, y": "position", "time": "timestamp, from s"}
    report.recognised["angle"] = "heading, from degrees clockwise from north"
    yield from (*metres.drain(), *degrees.drain())


def _origin(epoch: re.Match[bytes] | None) -> int:
    try:
        return iso_time(epoch[1].decode()) if epoch else 0
    except ValueError:
        return 0


def _degrees(element: Any) -> bool:
    """Whether x, y are degrees (SUMO then writes six decimals): the first vehicle tells."""
    x, y = finite(element.get("x")), finite(element.get("y"))
    decimals = min(len((element.get(k) or "").partition(".")[2]) for k in ("x", "y"))
    return decimals >= 5 and abs(x) <= 180.0 and abs(y) <= 90.0


def _add(rows: Rows, element: Any, record: int, origin: int, geographic: bool) -> None:
    attributes, step = element.attrib, element.getparent()
    seconds = finite(step.get("time") if step is not None else None)
    names = ("longitude", "latitude") if geographic else LOCAL
    place = dict(zip(names, (finite(attributes.get(k)) for k in "xy"), strict=True))
    if not abs(seconds) < 1e12:
        rows.reject(record, "step without a time", dict(attributes))
        return
    values: dict[str, Any] = {**place}
    for name in attributes:
        if name in ("z", "speed"):
            values[name] = finite(attributes[name])
        elif name not in _KNOWN:
            number = finite(attributes[name])
            values[name] = number if number == number else (attributes[name] or None)
    if "angle" in attributes:
        values["heading"] = heading_of_course(finite(attributes["angle"]))
    rows.add(attributes.get("id") or "vehicle", origin + round(seconds * 1e6), record, values, attributes)


IMPORTER = Importer("sumo-fcd", (".xml",), holding(b"<fcd-export", first=HEAD), read)
