"""Records of ROS 1 bags, format 2.0.  http://wiki.ros.org/Bags/Format/2.0.

Readers that go by the index at the end refuse a bag that was cut off altogether.
"""

import struct
from collections.abc import Iterator
from typing import Any

from fleetlog.importers._messages import Topic
from fleetlog.importers._open import LIMIT, Damaged, unpack
from fleetlog.importers._walk import FAULTS, Message, Record, Summary, Walk

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_LENGTH = struct.Struct("<I")
Header = dict[bytes, bytes]


class BagWalk(Walk):
    """An open bag; ``channels`` are its connections."""

    called = "a ROS 1 bag"
    magic = MAGIC
    chunk = CHUNK
    kinds = frozenset({MESSAGE, HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION})

    def _cut_off(self) -> bool:
        return self.summary() is None

    def summary(self) -> Summary | None:
        """See the base; from the connections and chunk infos at the end of the bag."""
        found = Summary()
        try:
            self.at = len(MAGIC)
            first = self._next()
            (at,) = struct.unpack("<Q", first.header[b"index_pos"])
            stated = tuple(_LENGTH.unpack(first.header[k])[0] for k in (b"conn_count", b"chunk_count"))
            if first.kind != HEADER or not 0 < at <= self.size:
                return None
            self.at = at
            while self.at < self.size:
                record = self._next()
                self._index(found, record)
                self.at = record.after
        except FAULTS:
            return None
        found.channels = dict(self.channels)
        return found if (len(self.channels), len(found.chunks)) == stated else None

    def _index(self, found: Summary, record: Record) -> None:
        if record.kind == CONNECTION:
            self._connect(record.header, record.data)
        elif record.kind == CHUNK_INFO:
            found.chunks.add(struct.unpack("<Q", record.header[b"chunk_pos"])[0])
            found.messages += sum(count for _, count in struct.iter_unpack("<II", record.data))
        else:
            raise Damaged("the index is wrong")

    def _next(self) -> Record:
        self.stream.seek(self.at)
        header = _header(self._block())
        data = self._block()
        return Record(_kind(header), header, data, self.stream.tell())

    def _block(self) -> bytes:
        head = self.stream.read(4)
        if len(head) < 4:
            raise Damaged("the bag breaks off")
        (length,) = _LENGTH.unpack(head)
        if length > min(self.size - self.stream.tell(), LIMIT):
            raise Damaged("a record runs beyond the end of the bag: it is cut off or damaged")
        return self.stream.read(length)

    def _take(self, record: Record) -> Iterator[Message]:
        if record.kind == INDEX:
            self.indexed += _LENGTH.unpack(record.header[b"count"])[0]
        elif record.kind != CHUNK:
            yield from self._item(record.kind, record.header, record.data)
        else:
            (size,) = _LENGTH.unpack(record.header[b"size"])
            data = unpack(record.header[b"compression"].decode("ascii", "replace"), record.data, size)
            at = 0
            while at < len(data):
                head, at = _cut(data, at)
                body, at = _cut(data, at)
                header = _header(head)
                yield from self._item(_kind(header), header, body)

    def _item(self, kind: int, header: Header, data: Any) -> Iterator[Message]:
        if kind == CONNECTION:
            self._connect(header, data)
        elif kind == MESSAGE:
            channel = self.channels.get(_LENGTH.unpack(header[b"conn"])[0])
            seconds, nanoseconds = struct.unpack("<II", header[b"time"])
            if channel is None:
                self.say("a message of an unknown connection")
                return
            self.count += 1
            yield channel, seconds * 1_000_000 + (nanoseconds + 500) // 1000, data

    def _connect(self, header: Header, data: bytes) -> None:
        (number,) = _LENGTH.unpack(header[b"conn"])
        about = _header(data)
        topic = about.get(b"topic") or header[b"topic"]
        schema = about.get(b"type", b"").decode("utf-8", "replace")
        self.channels[number] = Topic(topic.decode("utf-8", "replace"), schema, "ros1")


def _kind(header: Header) -> int:
    return int.from_bytes(header[b"op"], "little")


def _cut(data: bytes, at: int) -> tuple[bytes, int]:
    if len(data) - at < 4:
        raise Damaged("half a record at its end")
    (length,) = _LENGTH.unpack_from(data, at)
    end = at + 4 + length
    if end > len(data):
        raise Damaged("a record runs beyond its end")
    return data[at + 4 : end], end


def _header(data: bytes) -> Header:
    """The fields ``name=value`` of a header."""
    fields, at = {}, 0
    while at < len(data):
        field, at = _cut(data, at)
        name, _, value = field.partition(b"=")
        fields[name] = value
    return fields
