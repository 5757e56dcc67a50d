"""MCAP records, walked in the order of the file: every checksum verified, damaged chunks passed over, sizes bounded.

https://mcap.dev/spec.  The walk needs no index, so a file that was cut off gives all that is whole; where a record's length is
wrong, the index at the end of the file (if it is there) says where to go on.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from fleetlog.importers._bounded import LIMIT, Damaged, unpack
from fleetlog.importers._open import plural
from fleetlog.importers._report import ReadReport

MAGIC = b"\x89MCAP0\r\n"
DAMAGE_LINES = 10
_HEAD, _CHUNK, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<QQQI"), struct.Struct("<HIQQ")
_FOOTER = 9 + 20 + 8
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, CHUNK_INDEX, STATISTICS, DATA_END = 2, 3, 4, 5, 6, 8, 11, 15


class Channel(NamedTuple):
    """A channel: topic, name of the schema, encoding of the messages."""

    topic: str
    schema: str
    encoding: str


@dataclass
class Summary:
    """What the end of a whole file says about it."""

    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[int] = field(default_factory=list)
    messages: int | None = None


class McapFile:
    """An open MCAP file; ``channels`` grows while :meth:`messages` goes on."""

    def __init__(self, path: Path, stream: BinaryIO, report: ReadReport) -> None:
        self.stream, self.report = stream, report
        self.size = path.stat().st_size
        self.at = 0
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, str] = {}
        self._damages = 0
        self.count = 0

    def share(self) -> float:
        """Share of the file that has been read."""
        return self.at / max(self.size, 1)

    def summary(self) -> Summary | None:
        """Channels, chunk places and message count from the end of the file; None where that is missing or damaged."""
        if self.size < _FOOTER + len(MAGIC):
            return None
        self.stream.seek(self.size - _FOOTER)
        footer = self.stream.read(_FOOTER)
        op, length = _HEAD.unpack_from(footer)
        start, _, crc = struct.unpack_from("<QQI", footer, 9)
        if (
            not footer.endswith(MAGIC)
            or (op, length) != (FOOTER, 20)
            or not 8 <= start < self.size
            or self.size - start > LIMIT
        ):
            return None
        self.stream.seek(start)
        body = self.stream.read(self.size - _FOOTER - start)
        if crc and zlib.crc32(body + footer[:25]) != crc:
            return None
        found = Summary()
        try:
            for op, record in records(body):
                self._index(found, op, record)
        except (Damaged, struct.error, ValueError):
            return None
        found.channels = dict(self.channels)
        return found

    def _index(self, found: Summary, op: int, record: memoryview) -> None:
        if op == CHUNK_INDEX:
            found.chunks.append(struct.unpack_from("<Q", record, 16)[0])
        elif op == STATISTICS:
            found.messages = struct.unpack_from("<Q", record)[0]
        else:
            self._define(op, record)

    def messages(self, summary: Summary | None) -> Iterator[tuple[Channel, int, memoryview]]:
        """(channel, log time [us], data) of every whole message, in the order of the file."""
        self.at = len(MAGIC)
        while True:
            try:
                op, length = self._head()
                if op in (DATA_END, FOOTER):
                    break
                if op == CHUNK:
                    yield from self._chunk(self.at, self._body(length))
                elif op in (SCHEMA, CHANNEL, MESSAGE):
                    yield from self._record(op, memoryview(self._body(length)))
                self.at += 9 + length
            except Damaged as error:
                self._say(str(error))
                onward = [c for c in summary.chunks if c > self.at] if summary else []
                if not onward:
                    break
                self.at = min(onward)
        if not self._damages and not self._ended():
            self._say("the end of the file is cut off")
        if self._damages:
            whole = plural(self.count, "message")
            known = summary.messages if summary else None
            self.report.damaged(
                f"{whole} of {known:,} are whole" if known else f"{whole} before and between are whole"
            )

    def _ended(self) -> bool:
        self.stream.seek(max(self.size - len(MAGIC), 0))
        return self.stream.read() == MAGIC

    def _head(self) -> tuple[int, int]:
        self.stream.seek(self.at)
        head = self.stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Damaged(f"the file breaks off after {plural(self.at, 'byte')}")
        op, length = _HEAD.unpack(head)
        if not op:
            raise Damaged(f"no record at byte {self.at}")
        if length > self.size - self.at - _HEAD.size:
            raise Damaged(
                f"the record at byte {self.at} runs beyond the end of the file: it is cut off or damaged"
            )
        return op, length

    def _body(self, length: int) -> bytes:
        if length > LIMIT:
            raise Damaged(f"the record at byte {self.at} is larger than {LIMIT >> 20} MB")
        return self.stream.read(length)

    def _chunk(self, at: int, body: bytes) -> Iterator[tuple[Channel, int, memoryview]]:
        try:
            data = unpack_chunk(body)
            for op, record in records(data):
                yield from self._record(op, record)
        except (Damaged, struct.error, ValueError) as error:
            self._say(f"the chunk at byte {at} is damaged ({error})")

    def _record(self, op: int, record: memoryview) -> Iterator[tuple[Channel, int, memoryview]]:
        if op != MESSAGE:
            self._define(op, record)
            return
        number, _, time, _ = _MESSAGE.unpack_from(record)
        channel = self.channels.get(number)
        if channel is None:
            self._say(f"a message of the unknown channel {number}")
            return
        self.count += 1
        yield channel, min((time + 500) // 1000, 1 << 62), record[_MESSAGE.size :]

    def _define(self, op: int, record: memoryview) -> None:
        if op == SCHEMA:
            (number,) = struct.unpack_from("<H", record)
            self._schemas[number], _ = _text(record, 2)
        elif op == CHANNEL:
            number, schema = struct.unpack_from("<HH", record)
            topic, at = _text(record, 4)
            encoding, _ = _text(record, at)
            self.channels[number] = Channel(topic, self._schemas.get(schema, ""), encoding)

    def _say(self, text: str) -> None:
        self._damages += 1
        if self._damages <= DAMAGE_LINES:
            self.report.damaged(text)
        elif self._damages == DAMAGE_LINES + 1:
            self.report.damaged("more damage of this kind")


def _text(record: memoryview, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", record, at)
    if length > len(record) - at - 4:
        raise ValueError("a text runs beyond its record")
    return bytes(record[at + 4 : at + 4 + length]).decode("utf-8", "replace"), at + 4 + length


def records(data: bytes) -> Iterator[tuple[int, memoryview]]:
    """(opcode, content) of the records in a chunk."""
    view, at, end = memoryview(data), 0, len(data)
    while at < end:
        if end - at < _HEAD.size:
            raise Damaged("half a record at its end")
        op, length = _HEAD.unpack_from(view, at)
        at += _HEAD.size
        if length > end - at:
            raise Damaged("a record runs beyond its end")
        yield op, view[at : at + length]
        at += length


def unpack_chunk(body: bytes) -> bytes:
    """The records of a chunk, unpacked to at most the size that it states and checked; :class:`Damaged` otherwise."""
    _, _, size, crc = _CHUNK.unpack_from(body)
    packing, at = _text(memoryview(body), _CHUNK.size)
    (length,) = struct.unpack_from("<Q", body, at)
    packed = body[at + 8 : at + 8 + length]
    data = unpack(packing, packed, size)
    if crc and zlib.crc32(data) != crc:
        raise Damaged("its checksum is wrong")
    return data
