"""Garmin FIT: the record messages of an activity, read by fitdecode (the extra ``fit``)."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._rows import NAMES, Records, finite
from fleetlog.importers._units import microseconds
from fleetlog.importers.base import Importer
from fleetlog.registry import extra

SEMICIRCLE = 180.0 / 2**31  # Degrees: FIT counts half turns in 2^31 steps
PLACE = {"latitude": "position_lat", "longitude": "position_long"}
_NAMES: dict[str, str] = NAMES["fit"]


def sniff(path: Path, head: bytes) -> bool:
    """The mark in a FIT header."""
    return head[8:12] == b".FIT" and head[:1] in (b"\x0c", b"\x0e")


class _Fit(Records):
    """One row a record with a position; a file that breaks off gives what is before."""

    def records(self) -> Iterator[Any]:
        fitdecode = extra("fitdecode", "fit", "reading FIT needs fitdecode", self.path, FormatError)
        frames = fitdecode.FitReader(self.stream, error_handling=fitdecode.ErrorHandling.IGNORE)
        try:
            yield from (f for f in frames if isinstance(f, fitdecode.FitDataMessage) and f.name == "record")
        except Exception as error:  # the library raises several kinds on damaged files
            kind, met = type(error).__name__, self.rows.total + self.rows.rejected
            self.report.damaged(f"the file breaks off or is wrong after record {met} ({kind})")

    def take(self, frame: Any, number: int) -> None:
        given = {f.name: f.value for f in frame.fields}
        place = {n: finite(given.get(k)) * SEMICIRCLE for n, k in PLACE.items()}
        stamp = given.get("timestamp")
        if not isinstance(stamp, datetime):
            self.rows.reject(number, "record without a time")
            return
        values = {_NAMES[n]: finite(given[n]) for n in reversed(_NAMES) if n in given}
        self.rows.add(self.vehicle, microseconds(stamp), number, {**place, **values})

    def nothing(self) -> tuple[str, str]:
        return f"none of its {self.rows.rejected:,} records has a position", "record it with GPS"


IMPORTER = Importer("fit", (".fit",), sniff, _Fit.batches)
