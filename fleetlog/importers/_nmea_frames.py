"""A receiver's byte stream cut into NMEA sentences and UBX frames, every checksum verified."""

import re
from collections.abc import Iterator
from functools import reduce
from io import BufferedReader
from operator import xor
from typing import NamedTuple

BLOCK = 1 << 18
UBX_LIMIT = 8192  # Longest UBX payload that is believed; a longer one is two bytes of chance
SENTENCE_LIMIT = 1024
_START = re.compile(
    rb"\xb5b|[$!]([A-Z][A-Z0-9]{1,11}),([\x20-\x23\x25-\x29\x2b-\x7e]{0,1000})"
    rb"(\*[0-9A-Fa-f]{2})?(?=(\r?\n|\r)?)"
)


class Frame(NamedTuple):
    """A sentence or a UBX message, or what is wrong with it.

    ``kind`` is the address of a sentence (``b"GPGGA"``) or ``b"UBX"``; ``body`` the comma-separated fields,
    or class, id and payload; ``fault`` is None, or why the frame cannot be used; ``checked`` whether a
    checksum was there and right; ``bang`` marks the sentences that start with ``!``.
    """

    kind: bytes
    body: bytes
    line: int
    fault: str | None
    checked: bool
    bang: bool = False


def fletcher(data: bytes) -> tuple[int, int]:
    """UBX checksum: 8-bit Fletcher, u-blox protocol specification, section "UBX checksum"."""
    a = b = 0
    for byte in data:
        a += byte
        b += a
    return a & 0xFF, b & 0xFF


def frames(stream: BufferedReader) -> Iterator[Frame]:
    """All frames of the stream; what lies between them is passed over."""
    buffer, line, done = b"", 1, False
    while not done:
        block = stream.read(BLOCK)
        done = not block
        buffer += block
        at = 0
        while True:
            found = _START.search(buffer, at)
            keep = found.start() if found else max(at, len(buffer) - SENTENCE_LIMIT)
            if found is None or (not done and len(buffer) - keep < UBX_LIMIT + 8):
                break
            line += buffer.count(b"\n", at, found.start())
            frame, end = _ubx(buffer, found, line) if found[1] is None else _sentence(found, line, done)
            line += buffer.count(b"\n", found.start(), end)
            at = end
            if frame is not None:
                yield frame
        if not done:
            keep = max(at, keep)
            line += buffer.count(b"\n", at, keep)
            buffer = buffer[keep:]


def _sentence(found: re.Match[bytes], line: int, at_end: bool) -> tuple[Frame, int]:
    address, fields, check = found[1], found[2], found[3]
    bang = found[0][:1] == b"!"
    fault = None
    if check is None:
        if at_end and found.end() == len(found.string):
            fault = "the sentence is cut off by the end of the file"
        elif not found[4]:
            fault = "the sentence is broken off"
    elif int(check[1:], 16) != reduce(xor, address + b"," + fields):
        fault = "checksum of the sentence is wrong"
    return Frame(address, fields, line, fault, check is not None, bang), found.end()


def _ubx(buffer: bytes, found: re.Match[bytes], line: int) -> tuple[Frame | None, int]:
    start = found.start()
    length = int.from_bytes(buffer[start + 4 : start + 6], "little")
    end = start + 8 + length
    if length > UBX_LIMIT or len(buffer) < start + 6:
        return None, start + 2
    body = buffer[start + 2 : end - 2]
    fault = None
    if end > len(buffer):
        fault = "the UBX message is cut off by the end of the file"
    elif fletcher(body) != (buffer[end - 2], buffer[end - 1]):
        fault = "checksum of the UBX message is wrong"
    if fault is not None:
        return Frame(b"UBX", body[:2], line, fault, end <= len(buffer)), start + 2
    return Frame(b"UBX", body[:2] + body[4:], line, None, True), end
