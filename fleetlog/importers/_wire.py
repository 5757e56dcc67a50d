"""ROS, JSON and protobuf messages as bytes, read field by field; no schema, no code from the file.

CDR: OMG DDSI-RTPS, encapsulation identifiers 0x0000 to 0x0009; a primitive is aligned to its own size (in
XCDR2 at most 4 bytes) from the end of the encapsulation header.  ROS 1 packs without gaps, little endian.
"""

import json
import struct
from collections.abc import Iterator
from functools import cache
from typing import Any

_SIZES = {"b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "f": 4, "d": 8}
_STAMP: dict[int, Any] = {1: "sec", 2: "nsec"}
_POINT: dict[int, Any] = {1: "x", 2: "y", 3: "z"}
_POSE = {1: ("position", _POINT), 2: ("orientation", _POINT | {4: "w"})}
_LAYOUTS: dict[str, dict[int, Any]] = {
    "LocationFix": {1: "latitude", 2: "longitude", 3: "altitude", 6: ("timestamp", _STAMP)},
    "PoseInFrame": {1: ("timestamp", _STAMP), 3: ("pose", _POSE)},
}
"""Names of the fields of Foxglove's messages by number, with the layout of those that are messages."""


@cache
def _layout(order: str, kind: str, count: int) -> struct.Struct:
    return struct.Struct(f"{order}{count}{kind}")


class Wire:
    """A place in one message; methods raise :class:`ValueError` or ``struct.error`` beyond its end."""

    __slots__ = ("_at", "_base", "_data", "_order", "_ros1", "_widest")

    def __init__(self, data: Any, *, ros1: bool = False) -> None:
        self._data, self._ros1 = data, ros1
        self._order, self._widest, self._at, self._base = "<", 1, 0, 0
        if not ros1:
            if len(data) < 4 or data[0] or data[1] not in (0, 1, 6, 7):
                raise ValueError("the message is not plain CDR")
            self._order = "<" if data[1] & 1 else ">"
            self._widest = 8 if data[1] < 6 else 4
            self._at = self._base = 4

    def take(self, kind: str, count: int = 1) -> tuple[Any, ...]:
        """``count`` values of a :mod:`struct` type."""
        size = _SIZES[kind]
        step = min(size, self._widest)
        at = self._at + (self._base - self._at) % step
        self._at = at + size * count
        return _layout(self._order, kind, count).unpack_from(self._data, at)

    def text(self) -> str:
        """A string."""
        (length,) = self.take("I")
        if length > len(self._data) - self._at:
            raise ValueError("a string runs beyond the end of the message")
        self._at += length
        return bytes(self._data[self._at - length : self._at]).rstrip(b"\0").decode("utf-8", "replace")

    def header(self) -> tuple[int, str]:
        """The stamp [us] of a ``std_msgs/Header``, 0 where it was not set, and its frame."""
        if self._ros1:
            self.take("I")
            seconds, nanoseconds = self.take("I", 2)
        else:
            (seconds,), (nanoseconds,) = self.take("i"), self.take("I")
        return int(seconds) * 1_000_000 + (int(nanoseconds) + 500) // 1000, self.text()


def from_json(data: Any) -> dict[str, Any]:
    """The object that a message is."""
    message = json.loads(str(data, "utf-8"))
    if not isinstance(message, dict):
        raise ValueError("the message is no JSON object")
    return message


def from_protobuf(name: str, data: Any) -> dict[str, Any]:
    """One of Foxglove's messages, as it would be in JSON; broken bytes raise."""
    return _named(_LAYOUTS[name], bytes(data))


def _named(layout: dict[int, Any], data: bytes) -> dict[str, Any]:
    """A message by the names of its fields; a zero is not written."""
    given, out = dict(_fields(data)), {}
    for number, name in layout.items():
        if isinstance(name, str):
            out[name] = given.get(number, 0.0)
        else:
            out[name[0]] = _named(name[1], given.get(number, b""))
    return out


def _fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """(field number, value) of a message: varints as int, 64-bit as double, 32-bit as int, the rest as bytes.

    https://protobuf.dev/programming-guides/encoding/
    """
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire in (1, 5):
            yield number, struct.unpack_from("<d" if wire == 1 else "<I", data, at)[0]
            at += 8 if wire == 1 else 4
        elif wire == 2:
            length, at = _varint(data, at)
            if length > end - at:
                raise ValueError("a field runs beyond the end of the message")
            yield number, data[at : at + length]
            at += length
        elif wire == 0:
            value, at = _varint(data, at)
            yield number, value
        else:
            raise ValueError("unknown wire type")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number is too long")
