"""ASAM OSI traces (``.osi``): messages behind their lengths, 32 bits in little endian.

What kind of message a trace holds stands in its name (``..._gt_...``, as the standard names files); where it
does not, the first message tells.  In MCAP files, messages of the same kinds are read as topics.
"""

import re
import struct
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from fleetlog.importers._open import head_of, open_bytes, plain_suffix
from fleetlog.importers._osi import SCHEMAS, vehicles
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import Rows, gather, unplaced
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

LIMIT = 1 << 26
"""Bytes of one message that are believed."""
_LENGTH = struct.Struct("<I")
_VERSION = 0x0A
"""Every message begins with its version: field 1, a message."""
_KINDS = {"sv": "osi3.SensorView", "gt": "osi3.GroundTruth", "tu": "osi3.TrafficUpdate"}


def sniff(path: Path, head: bytes) -> bool:
    """A length and the version of a message, in a file with the right suffix."""
    first = _LENGTH.unpack_from(head)[0] if len(head) > 4 else 0
    return plain_suffix(path) == ".osi" and 0 < first <= LIMIT and head[4] == _VERSION


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a vehicle and message, in the metres of the trace."""
    stream, raw = open_bytes(path, options.report)
    rows, schema = Rows("x", "y", share=lambda: raw.share), _schema(path)

    def take(data: bytes, number: int) -> None:
        try:
            found = vehicles(schema, data)
        except ValueError as error:
            rows.reject(number, f"no {schema} message", error)
            return
        for sample in found:
            if unplaced(sample.values):
                rows.reject(number, "position is not a number", sample.values)
            else:
                rows.add(sample.vehicle, options.origin + sample.stamp, number, sample.values)

    with stream:
        yield from gather(_messages(stream, options.report), take, rows)
    if not rows.total:
        raise options.report.nothing(f"no vehicle in its {schema} messages", "record ground truth")
    options.report.recognised[schema] = "position, heading and speed of every vehicle, from m, rad and m/s"
    yield from rows.drain()


def _messages(stream: BufferedReader, report: ReadReport) -> Iterator[bytes]:
    done = 0
    while head := stream.read(4):
        length = _LENGTH.unpack(head)[0] if len(head) == 4 else LIMIT + 1
        data = stream.read(length) if length <= LIMIT else b""
        if len(data) < length:
            report.damaged(f"the trace breaks off or is wrong after {done} messages")
            return
        done += 1
        yield data


def _schema(path: Path) -> str:
    """The kind of messages: as the name says, else the first one that finds vehicles."""
    for word in re.split(r"[_.]", path.name.lower()):
        if word in _KINDS:
            return _KINDS[word]
    head = head_of(path, LIMIT)
    first = head[4 : 4 + _LENGTH.unpack_from(head)[0]]
    return next((s for s in SCHEMAS if _finds(s, first)), "osi3.GroundTruth")


def _finds(schema: str, data: bytes) -> bool:
    try:
        return bool(vehicles(schema, data))
    except ValueError:
        return False


IMPORTER = Importer("osi", (".osi",), sniff, read)
