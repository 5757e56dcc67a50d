"""A text log as blocks of whole lines in UTF-8, with the number of each line."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetlog.core.trajectory import Ints
from fleetlog.errors import FormatError
from fleetlog.importers._csv_lines import with_line_feeds
from fleetlog.importers._open import open_bytes
from fleetlog.importers._report import ReadReport

SIZE = 8 << 20
"""Bytes in a block."""
LONGEST = 8 << 20
"""Bytes in a line."""
TORN = 1 << 20
"""Bytes of a quoted cell of several lines that the end of a block would tear apart."""


@dataclass(frozen=True)
class Block:
    """Whole lines from number ``first`` (from 1); ``cut``: the last one lacks its line end."""

    text: bytes
    first: int
    progress: float
    cut: bool = False

    def lines(self) -> Ints:
        """Numbers of the lines that are not blank."""
        raw = np.frombuffer(self.text, np.uint8)
        ends = np.flatnonzero(raw == 10)
        if len(raw) and raw[-1] != 10:
            ends = np.append(ends, len(raw))
        starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
        length = ends - starts
        carriage = (length == 1) & (raw[np.minimum(starts, len(raw) - 1)] == 13) if len(ends) else length > 0
        return np.asarray(self.first + np.flatnonzero((length > 0) & ~carriage), dtype=np.int64)

    def texts(self, numbers: list[int]) -> list[str]:
        """The text of some lines, by their numbers."""
        if not numbers:
            return []
        lines = self.text.decode("utf-8", "replace").split("\n")
        return [lines[n - self.first].rstrip("\r") for n in numbers]


def guess_encoding(head: bytes) -> str:
    """``utf-8-sig``, ``utf-16`` or ``utf-8`` where the bytes say so, else ``cp1252``, which fits all."""
    if head.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if len(head) > 3 and head[1::2].count(0) > 0.4 * len(head[1::2]):
        return "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def blocks(path: Path, encoding: str, report: ReadReport, size: int = SIZE) -> Iterator[Block]:
    """The file, block by block; carriage returns alone end lines too (:func:`with_line_feeds`)."""
    stream, raw = open_bytes(path, report)
    decoder = codecs.getincrementaldecoder(encoding)(errors="replace") if encoding != "utf-8" else None
    rest, first, ended = b"", 1, False
    with stream:
        while not ended:
            data = stream.read(size)
            ended = not stream.peek(1)
            text = rest + (decoder.decode(data, ended).encode("utf-8", "replace") if decoder else data)
            # A carriage return at the very end may be half of a line end.
            half = b"\r" if text.endswith(b"\r") and not ended else b""
            text = with_line_feeds(text.removesuffix(half), report) + half
            last = text.rfind(b"\n") + 1
            end = last if ended else _end_of_record(text, last)
            if end:
                yield Block(text[:end], first, raw.share)
                first += text.count(b"\n", 0, end)
            rest = text[end:]
            if len(text) - last > LONGEST:
                what, place = f"the line is longer than {LONGEST >> 20} MB", first + rest.count(b"\n")
                raise FormatError(what, where=path, place=f"line {place}", do="check the format")
        if rest:
            yield Block(rest, first, 1.0, cut=True)


def _end_of_record(text: bytes, last: int) -> int:
    """The last line end outside of quotes; ``last``, the end of the last line, where quotes make no sense."""
    end, odd = last, text.count(b'"', 0, last) % 2
    while odd and last - end < TORN:
        line = text.rfind(b"\n", 0, end - 1) + 1
        odd ^= text.count(b'"', line, end) % 2
        end = line
    return end if not odd and last - end < TORN else last
