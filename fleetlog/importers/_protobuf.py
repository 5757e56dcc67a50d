"""The wire format of protocol buffers, as much as the messages here need; no schema, no code."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

_DOUBLE, _FIXED32 = struct.Struct("<d"), struct.Struct("<I")


def fields(data: Any) -> Iterator[tuple[int, Any]]:
    """(field number, value) of a message: varints as int, 64-bit as double, 32-bit as int, the rest as bytes.

    https://protobuf.dev/programming-guides/encoding/; raises :class:`ValueError` or ``struct.error`` on
    broken bytes.
    """
    data = bytes(data)
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == 1:
            yield number, _DOUBLE.unpack_from(data, at)[0]
            at += 8
        elif wire == 2:
            length, at = _varint(data, at)
            if length > end - at:
                raise ValueError("a field runs beyond the end of the message")
            yield number, data[at : at + length]
            at += length
        elif wire == 0:
            value, at = _varint(data, at)
            yield number, value
        elif wire == 5:
            yield number, _FIXED32.unpack_from(data, at)[0]
            at += 4
        else:
            raise ValueError("unknown wire type")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 70:
        if at >= len(data):
            raise ValueError("the message is cut off")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise ValueError("a number is too long")
