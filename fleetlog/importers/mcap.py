"""MCAP recordings of Foxglove's and ROS 2's positions and batteries.

Every checksum is verified, sizes are bounded.  https://mcap.dev/spec"""

import struct
import zlib
from collections.abc import Iterator
from functools import partial

from fleetlog.importers._messages import Topic
from fleetlog.importers._open import LIMIT, Damaged, cut, unpack
from fleetlog.importers._topics import read_recording
from fleetlog.importers._walk import Item, Message, Record, Walk
from fleetlog.importers.base import Importer, holding

MAGIC = b"\x89MCAP0\r\n"
_HEAD, _CHUNK, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<QQQI"), struct.Struct("<HIQQ")
_FOOTER, _SIZE, _LONG = 9 + 20 + 8, struct.Struct("<I"), struct.Struct("<Q")
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(2, 9)
STATISTICS, DATA_END = 11, 15
_READ = frozenset({SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS})


class McapWalk(Walk):
    """An open MCAP file."""

    called = "an MCAP file"
    magic = tail = MAGIC
    chunk, inner = CHUNK, frozenset({SCHEMA, CHANNEL, MESSAGE})
    ends = frozenset({FOOTER, DATA_END})
    # From 128 on kinds are those of whoever wrote the file.
    kinds = frozenset({*range(1, 16), *range(128, 256)})

    def _index(self) -> bool:
        """From the summary, whose checksum is verified where it has one."""
        if self.size < _FOOTER + len(MAGIC):
            return False
        self.stream.seek(self.size - _FOOTER)
        footer = self.stream.read(_FOOTER)
        head, (start, _, crc) = _HEAD.unpack_from(footer), struct.unpack_from("<QQI", footer, 9)
        placed = len(MAGIC) <= start <= self.size - _FOOTER and self.size - start <= LIMIT
        if not footer.endswith(MAGIC) or head != (FOOTER, 20) or not placed:
            return False
        self.stream.seek(start)
        body = self.stream.read(self.size - _FOOTER - start)
        if crc and zlib.crc32(body + footer[:25]) != crc:
            return False
        for item in records(body):
            self._take(*item)
        return True

    def _next(self) -> Record:
        self.stream.seek(self.at)
        head = self.stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Damaged("the file breaks off")
        kind, length = _HEAD.unpack(head)
        if not kind:
            raise Damaged("no record")
        if length > self.size - self.at - _HEAD.size:
            raise Damaged("a record runs beyond the end of the file: it is cut off or damaged")
        read = kind in _READ or self.at in self.chunks
        if read and length > LIMIT:
            raise Damaged(f"a record is larger than {LIMIT >> 20} MB")
        data = memoryview(self.stream.read(length) if read else b"")
        return Record(kind, None, data, self.at + _HEAD.size + length)

    def _items(self, chunk: Record) -> Iterator[Item]:
        """Unpacked within the size that the chunk states, and checked."""
        _, _, size, crc = _CHUNK.unpack_from(chunk.data)
        packing, at = _text(chunk.data, _CHUNK.size)
        (length,) = _LONG.unpack_from(chunk.data, at)
        data = unpack(packing, bytes(chunk.data[at + 8 : at + 8 + length]), size)
        if crc and zlib.crc32(data) != crc:
            raise Damaged("its checksum is wrong")
        return records(data)

    def _take(self, kind: int, header: None, data: memoryview) -> Message | None:
        if kind == MESSAGE:
            number, _, time, _ = _MESSAGE.unpack_from(data)
            return number, min((time + 500) // 1000, 1 << 62), data[_MESSAGE.size :]
        if kind == SCHEMA:
            (number,) = struct.unpack_from("<H", data)
            self.schemas[number], _ = _text(data, 2)
        elif kind == CHANNEL:
            number, schema = struct.unpack_from("<HH", data)
            topic, at = _text(data, 4)
            encoding, _ = _text(data, at)
            self.channels[number] = Topic(topic, self.schemas.get(schema, ""), encoding)
        elif kind == MESSAGE_INDEX:
            self.indexed += (len(data) - 6) // 16
        elif kind == CHUNK_INDEX:
            self.chunks[struct.unpack_from("<Q", data, 16)[0]] = 0
        elif kind == STATISTICS:
            (self.stated,) = struct.unpack_from("<Q", data)
        return None


def _text(record: memoryview, at: int) -> tuple[str, int]:
    text, end = cut(record, at, _SIZE)
    return bytes(text).decode("utf-8", "replace"), end


def records(data: bytes) -> Iterator[Item]:
    """The records in a chunk; none has a header."""
    view, at = memoryview(data), 0
    while at < len(view):
        kind = view[at]
        content, at = cut(view, at + 1, _LONG)
        yield kind, None, content


IMPORTER = Importer("mcap", (".mcap",), holding(MAGIC, first=len(MAGIC)), partial(read_recording, McapWalk))
