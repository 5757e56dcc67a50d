"""ROS 1 bags, format 2.0, walked in the order of the file: no index is needed, so a bag that was cut off gives what is whole.

http://wiki.ros.org/Bags/Format/2.0.  Readers that go by the index at the end refuse such a bag altogether.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from fleetlog.importers._bounded import LIMIT, Damaged, unpack
from fleetlog.importers._mcap_walk import Channel
from fleetlog.importers._open import plural
from fleetlog.importers._report import ReadReport

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, HEADER, CHUNK, CONNECTION = 2, 3, 5, 7
DAMAGE_LINES = 10
_LENGTH = struct.Struct("<I")


class BagFile:
    """An open bag; ``channels`` by connection number grows while :meth:`messages` goes on."""

    def __init__(self, path: Path, stream: BinaryIO, report: ReadReport) -> None:
        self.stream, self.report = stream, report
        self.size = path.stat().st_size
        self.at = 0
        self.count = 0
        self.channels: dict[int, Channel] = {}
        self._damages = 0

    def share(self) -> float:
        """Share of the file that has been read."""
        return self.at / max(self.size, 1)

    def indexed(self) -> bool:
        """Fill ``channels`` from the index at the end; False where there is none."""
        try:
            header, _, _ = self._record(len(MAGIC))
            (at,) = struct.unpack("<Q", header[b"index_pos"])
            (expected,) = _LENGTH.unpack(header[b"conn_count"])
            if header[b"op"] != bytes([HEADER]) or not 0 < at <= self.size:
                return False
            while at < self.size and len(self.channels) < expected:
                header, data, at = self._record(at)
                self._connect(header, data)
        except (Damaged, KeyError, struct.error):
            return False
        return len(self.channels) == int(expected)

    def messages(self) -> Iterator[tuple[Channel, int, bytes]]:
        """(connection, time received [us], data) of every whole message."""
        self.at = len(MAGIC)
        while self.at < self.size:
            try:
                header, data, after = self._record(self.at)
                if header.get(b"op") == bytes([CHUNK]):
                    yield from self._chunk(header, data)
                else:
                    yield from self._item(header, data)
            except Damaged as error:
                self._say(f"{error} at byte {self.at}")
                break
            except (KeyError, struct.error) as error:
                self._say(f"the record at byte {self.at} lacks a field ({type(error).__name__})")
            self.at = after
        if self._damages:
            self.report.damaged(f"{plural(self.count, 'message')} before and between are whole")

    def _record(self, at: int) -> tuple[dict[bytes, bytes], bytes, int]:
        """Header, data and the place after the record at ``at``."""
        self.stream.seek(at)
        header = _header(self._block())
        data = self._block()
        return header, data, self.stream.tell()

    def _block(self) -> bytes:
        head = self.stream.read(4)
        if len(head) < 4:
            raise Damaged("the bag breaks off")
        (length,) = _LENGTH.unpack(head)
        if length > min(self.size - self.stream.tell(), LIMIT):
            raise Damaged("a record runs beyond the end of the bag: it is cut off or damaged")
        return self.stream.read(length)

    def _chunk(self, header: dict[bytes, bytes], packed: bytes) -> Iterator[tuple[Channel, int, bytes]]:
        try:
            (size,) = _LENGTH.unpack(header[b"size"])
            data = unpack(header[b"compression"].decode("ascii", "replace"), packed, size)
            at = 0
            while at < len(data):
                head, at = _cut(data, at)
                body, at = _cut(data, at)
                yield from self._item(_header(head), body)
        except (Damaged, KeyError, struct.error) as error:
            self._say(f"the chunk at byte {self.at} is damaged ({error})")

    def _item(self, header: dict[bytes, bytes], data: bytes) -> Iterator[tuple[Channel, int, bytes]]:
        op = header[b"op"]
        if op == bytes([CONNECTION]):
            self._connect(header, data)
        elif op == bytes([MESSAGE]):
            channel = self.channels.get(_LENGTH.unpack(header[b"conn"])[0])
            seconds, nanoseconds = struct.unpack("<II", header[b"time"])
            if channel is None:
                self._say("a message of an unknown connection")
                return
            self.count += 1
            yield channel, seconds * 1_000_000 + (nanoseconds + 500) // 1000, data

    def _connect(self, header: dict[bytes, bytes], data: bytes) -> None:
        if header[b"op"] != bytes([CONNECTION]):
            raise Damaged("the index is wrong")
        (number,) = _LENGTH.unpack(header[b"conn"])
        about = _header(data)
        topic = about.get(b"topic") or header[b"topic"]
        schema = about.get(b"type", b"").decode("utf-8", "replace")
        self.channels[number] = Channel(topic.decode("utf-8", "replace"), schema, "ros1")

    def _say(self, text: str) -> None:
        self._damages += 1
        if self._damages <= DAMAGE_LINES:
            self.report.damaged(text)


def _cut(data: bytes, at: int) -> tuple[bytes, int]:
    if len(data) - at < 4:
        raise Damaged("half a record at its end")
    (length,) = _LENGTH.unpack_from(data, at)
    end = at + 4 + length
    if end > len(data):
        raise Damaged("a record runs beyond its end")
    return data[at + 4 : end], end


def _header(data: bytes) -> dict[bytes, bytes]:
    """The fields ``name=value`` of a header."""
    fields, at = {}, 0
    while at < len(data):
        field, at = _cut(data, at)
        name, _, value = field.partition(b"=")
        fields[name] = value
    return fields
