"""SUMO's floating car data (``--fcd-output``), XML: every vehicle at every step.

``angle`` is clockwise from north [degrees]; ``x, y`` are metres of the network, or degrees where
SUMO was run with ``--fcd-output.geo``.
``time`` counts seconds from the start of the simulation, so it is placed at the epoch that the file names
(fleetlog's
exporter writes it) or at 1970.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.importers._rows import Rows, finite, heading_of_course
from fleetlog.importers._times import iso_time
from fleetlog.importers._xml import Elements, nothing_usable
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

_EPOCH = re.compile(rb"fleetlog-epoch ([0-9T:.Z+-]{10,40})")
_KNOWN = ("id", "x", "y", "angle")


def sniff(path: Path, head: bytes) -> bool:
    """Whether the root is ``fcd-export``."""
    return b"<fcd-export" in head


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a vehicle and step."""
    from fleetlog.importers._open import head_of

    epoch = _EPOCH.search(head_of(path, 4096))
    origin = options.origin or _origin(epoch)
    elements = Elements(path, options.report, ("vehicle", "person", "timestep"))
    positions: dict[bool, Rows] = {}
    record = 0
    for tag, element in elements:
        if tag != "vehicle":
            continue
        record += 1
        geographic = _degrees(positions, element)
        if geographic not in positions:
            names = ("latitude", "longitude") if geographic else ("x", "y")
            positions[geographic] = Rows(*names, share=elements.share)
        rows = positions[geographic]
        rows.attempt(record, _add, rows, element, record, origin, geographic)
        if rows.full:
            yield rows.take()
    if not any(r.total for r in positions.values()):
        raise nothing_usable(
            path, options.report, "no vehicle with a position in it", "write it with --fcd-output"
        )
    options.report.recognised.update(
        {
            "x, y": "position",
            "angle": "heading, from degrees clockwise from north",
            "time": "timestamp, from s",
        }
    )
    for rows in positions.values():
        yield from rows.drain()


def _origin(epoch: re.Match[bytes] | None) -> int:
    try:
        return iso_time(epoch[1].decode()) if epoch else 0
    except ValueError:
        return 0


def _degrees(known: dict[bool, Rows], element: Any) -> bool:
    """Whether x, y are degrees: SUMO then writes six decimals and more; decided by the first vehicle, kept
    for the file.
    """
    if known:
        return next(iter(known))
    x, y = finite(element.get("x")), finite(element.get("y"))
    decimals = min(len((element.get(k) or "").partition(".")[2]) for k in ("x", "y"))
    return decimals >= 5 and abs(x) <= 180.0 and abs(y) <= 90.0


def _add(rows: Rows, element: Any, record: int, origin: int, geographic: bool) -> None:
    attributes = element.attrib
    step = element.getparent()
    seconds = finite(step.get("time") if step is not None else None)
    x, y = finite(attributes.get("x")), finite(attributes.get("y"))
    if x != x or y != y or not abs(seconds) < 1e12:
        rows.reject(record, "no time or position", dict(attributes))
        return
    names = ("longitude", "latitude") if geographic else ("x", "y")
    values: dict[str, Any] = {names[0]: x, names[1]: y}
    for name in attributes:
        if name in ("z", "speed"):
            values[name] = finite(attributes[name])
        elif name not in _KNOWN:
            _keep(values, name, attributes[name])
    if "angle" in attributes:
        values["heading"] = heading_of_course(finite(attributes["angle"]))
    rows.add(attributes.get("id") or "vehicle", origin + round(seconds * 1e6), record, values)


def _keep(values: dict[str, Any], name: str, text: str) -> None:
    number = finite(text)
    values[name] = number if number == number else (text or None)


IMPORTER = Importer("sumo-fcd", (".xml",), sniff, read)
