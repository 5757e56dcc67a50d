"""Garmin FIT: the record messages of an activity, read by fitdecode (the extra ``fit``)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes, plain_stem
from fleetlog.importers._rows import Rows, finite
from fleetlog.importers._times import microseconds
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

SEMICIRCLE = 180.0 / 2**31
"""Degrees: FIT counts half turns in 2^31 steps."""
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
    try:
        import fitdecode
    except ImportError:
        stream.close()
        what, do = "reading FIT needs fitdecode", 'install it with: pip install "fleetlog[fit]"'
        raise FormatError(what, where=path, do=do) from None
    rows = Rows("latitude", "longitude", share=lambda: raw.share)
    vehicle = options.vehicle or plain_stem(path)
    number = 0
    with stream, fitdecode.FitReader(stream, error_handling=fitdecode.ErrorHandling.IGNORE) as frames:
        try:
            for frame in frames:
                if isinstance(frame, fitdecode.FitDataMessage) and frame.name == "record":
                    number += 1
                    rows.attempt(number, _add, rows, frame, vehicle, number)
                if rows.full:
                    yield rows.take()
        except Exception as error:  # the library raises several kinds on damaged files
            options.report.damaged(
                f"the file breaks off or is wrong after record {number} ({type(error).__name__})"
            )
    if not rows.total:
        raise FormatError(
            f"none of its {number:,} records has a position", where=path, do="record it with GPS"
        )
    options.report.recognised.update({
        "position_lat, position_long": "position, WGS 84, from semicircles", "timestamp": "timestamp, UTC",
        "enhanced_altitude": "z, from m", "enhanced_speed": "speed, from m/s",
    })  # fmt: skip
    yield from rows.drain()


def _add(rows: Rows, frame: Any, vehicle: str, number: int) -> None:
    given = {f.name: f.value for f in frame.fields}
    latitude, longitude = (finite(given.get(n)) * SEMICIRCLE for n in ("position_lat", "position_long"))
    if latitude != latitude or longitude != longitude:
        rows.reject(number, "record without a position", "")
        return
    values = {NAMES[n]: finite(given[n]) for n in reversed(NAMES) if n in given}
    stamp = given.get("timestamp")
    if stamp is None or not hasattr(stamp, "timestamp"):
        rows.reject(number, "record without a time", "")
        return
    rows.add(vehicle, microseconds(stamp), number, {"latitude": latitude, "longitude": longitude, **values})


IMPORTER = Importer("fit", (".fit",), sniff, read)
