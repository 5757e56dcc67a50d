"""Garmin FIT: the record messages of an activity, read by fitdecode (the extra ``fit``)."""

from collections.abc import Iterator
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes
from fleetlog.importers._rows import Rows, finite, gather
from fleetlog.importers._times import microseconds
from fleetlog.importers.base import Importer, RawBatch, ReadOptions
from fleetlog.registry import extra

SEMICIRCLE = 180.0 / 2**31  # Degrees: FIT counts half turns in 2^31 steps
PLACE = {"latitude": "position_lat", "longitude": "position_long"}
NAMES = {
    "enhanced_altitude": "z", "altitude": "z", "enhanced_speed": "speed", "speed": "speed", "power": "watts",
    "temperature": "ambient_temperature", "distance": "distance",
}  # fmt: skip


def sniff(path: Path, head: bytes) -> bool:
    """The mark in a FIT header."""
    return head[8:12] == b".FIT" and head[:1] in (b"\x0c", b"\x0e")


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a record with a position; a file that breaks off gives what is before."""
    stream, raw = open_bytes(path, options.report)
    rows = Rows("latitude", "longitude", share=lambda: raw.share)
    with stream:
        fitdecode = extra("fitdecode", "fit", "reading FIT needs fitdecode", path, FormatError)
        frames = fitdecode.FitReader(stream, error_handling=fitdecode.ErrorHandling.IGNORE)
        records = (f for f in frames if isinstance(f, fitdecode.FitDataMessage) and f.name == "record")
        try:
            yield from gather(records, partial(_add, rows, options.name), rows)
        except Exception as error:  # the library raises several kinds on damaged files
            kind, met = type(error).__name__, rows.total + rows.rejected
            options.report.damaged(f"the file breaks off or is wrong after record {met} ({kind})")
    if not rows.total:
        what = f"none of its {rows.rejected:,} records has a position"
        raise FormatError(what, where=path, do="record it with GPS")
    options.report.recognised |= {
        "position_lat, position_long": "position, WGS 84, from semicircles", "timestamp": "timestamp, UTC",
        "enhanced_altitude": "z, from m", "enhanced_speed": "speed, from m/s",
    }  # fmt: skip
    yield from rows.drain()


def _add(rows: Rows, vehicle: str, frame: Any, number: int) -> None:
    given = {f.name: f.value for f in frame.fields}
    place = {n: finite(given.get(k)) * SEMICIRCLE for n, k in PLACE.items()}
    stamp = given.get("timestamp")
    if not isinstance(stamp, datetime):
        rows.reject(number, "record without a time", "")
        return
    values = {NAMES[n]: finite(given[n]) for n in reversed(NAMES) if n in given}
    rows.add(vehicle, microseconds(stamp), number, {**place, **values})


IMPORTER = Importer("fit", (".fit",), sniff, read)
