"""Files as bytes, whether packed or not, and the report of what a file turned out to hold.

A packed file that is cut off or broken gives what is whole."""

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from fleetlog.core.files import open_regular
from fleetlog.core.words import count
from fleetlog.errors import FormatError


@dataclass
class ReadReport:
    """Format, recognised columns, notes and damage of one file; an importer fills it while it reads."""

    path: Path
    format: str = ""
    recognised: dict[str, str] = field(default_factory=dict)
    """Column or field of the log -> what it was taken for, as ``"speed, from km/h"``."""
    notes: list[str] = field(default_factory=list)  # Anything else that was decided and not asked for
    damage: list[str] = field(default_factory=list)
    """What is broken or cut off, where, and how much is whole; any entry makes the exit status 3."""
    file: str = ""  # Its name in a summary
    rows: int = 0  # That were read, refused ones among them

    def note(self, text: str) -> None:
        """Say something once."""
        if text not in self.notes:
            self.notes.append(text)

    def tally(self, number: int, noun: str, what: str) -> None:
        """Say of how many things ``what`` was done, if of any."""
        if number:
            self.note(f"{count(number, noun)} {what}")

    def damaged(self, text: str) -> None:
        """Report damage once."""
        if text not in self.damage:
            self.damage.append(text)

    def take(self, other: "ReadReport") -> None:
        """Say what another report of the file says."""
        self.notes += [text for text in other.notes if text not in self.notes]
        self.damage += [text for text in other.damage if text not in self.damage]

    def to_dict(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        return {k: getattr(self, k) for k in ("file", "format", "rows", "recognised", "notes", "damage")}

    def nothing(self, what: str, do: str = "check the format") -> FormatError:
        """The error for a file that gave no row: what it holds, and the first damage that was met."""
        damage = f"; {self.damage[0]}" if self.damage else ""
        return FormatError(what + damage, where=self.path, do=do)


HEAD = 1 << 16
RATIO = 250  # A packed file that gives more than so many times its size, beyond ``FREE`` bytes, is a bomb
FREE = 1 << 26
LARGEST = 1 << 38  # Unpacked bytes of one file
PIECE = 1 << 12  # Bytes unpacked at a time; one by one before a break, where a piece with an error is lost
PACKET_LIMIT = 1 << 26  # Bytes of one packet that are believed
LIMIT = 1 << 28  # Bytes of one packed piece of a file, before or after unpacking, that are believed
_MAGIC = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"BZh": "bz2"}
_PACKED = {".gz": "gunzip", ".zst": "zstd -d", ".bz2": "bunzip2"}


class Damaged(Exception):
    """A stretch of the file cannot be read."""


def plain_suffix(path: Path) -> str:
    """The suffix in lower case, that of the compression taken off: ``.csv`` of ``a.CSV.gz``."""
    suffixes = [s.lower() for s in path.suffixes]
    if len(suffixes) > 1 and suffixes[-1] in _PACKED:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def plain_stem(path: Path) -> str:
    """The file's name without its suffixes of format and compression: ``truck.7`` of ``truck.7.csv.gz``."""
    return Path(path.stem).stem if path.suffix.lower() in _PACKED else path.stem


def compression(path: Path) -> str | None:
    """``gzip``, ``zstd``, ``bz2`` or None, from the first bytes."""
    if path.is_dir():
        return None
    with open_regular(path) as stream:
        magic = stream.read(4)
    return next((name for sign, name in _MAGIC.items() if magic.startswith(sign)), None)


class Unpacked(io.RawIOBase):
    """The bytes of a file, unpacked piece by piece; they end where it is broken, which ``report`` hears."""

    def __init__(self, path: Path, report: ReadReport | None = None) -> None:
        self.path, self._report, self._packing = path, report, compression(path)
        self._file: Any = open_regular(path)
        self._size = max(path.stat().st_size, 1)
        self._given, self._step = 0, PIECE
        self._unpacked: Any = pa.CompressedInputStream(self._file, self._packing) if self._packing else None

    def share(self) -> float:
        """Share of the file that has been read, 0 to 1."""
        return min(self._file.tell() / self._size, 1.0) if not self._file.closed else 1.0

    def readable(self) -> bool:
        """True."""
        return True

    def readinto(self, buffer: Any, /) -> int:
        """The next bytes; 0 at the end, and at the first damage."""
        view = memoryview(buffer).cast("B")
        if self._unpacked is None:
            return int(self._file.readinto(view))
        data = self._piece(min(len(view), self._step))
        view[: len(data)] = data
        self._given += len(data)
        if self._given > min(max(FREE, RATIO * self._size), LARGEST):
            what = f"unpacks to more than {self._given >> 20} MB, from {self._size:,} bytes"
            raise FormatError(what, where=self.path, do="if that is meant, unpack it first")
        return len(data)

    def _piece(self, size: int) -> bytes:
        try:
            return bytes(self._unpacked.read(size))
        except (OSError, pa.ArrowException) as error:
            if self._step > 1:
                self._step = 1
                self._unpacked = pa.CompressedInputStream(open_regular(self.path), self._packing)
                for done in range(0, self._given, PIECE):
                    self._unpacked.read(min(self._given - done, PIECE))
                return self._piece(1)
            self._unpacked = io.BytesIO()
            if self._report is not None:
                what = f"the {self._packing} packing is broken or cut off"
                at = count(self._given, "byte")
                self._report.damaged(f"{what} after about {at} of unpacked log ({error})")
            return b""

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def open_bytes(path: Path, report: ReadReport | None = None) -> tuple[io.BufferedReader, Callable[[], float]]:
    """The unpacked bytes, buffered, and what tells the share of the file itself that has been read."""
    raw = Unpacked(path, report)
    return io.BufferedReader(raw, 1 << 20), raw.share


def head_of(path: Path, size: int = HEAD) -> bytes:
    """The first bytes, unpacked; ``b""`` for a folder."""
    if path.is_dir():
        return b""
    stream, _ = open_bytes(path)
    with stream:
        return stream.read(size)


def packets(stream: io.BufferedReader, head: struct.Struct, report: ReadReport) -> Iterator[tuple[Any, ...]]:
    """The data behind every ``head``, whose last field is their length, after its other fields."""
    done = 0
    while start := stream.read(head.size):
        *said, length = head.unpack(start) if len(start) == head.size else (PACKET_LIMIT + 1,)
        data = stream.read(length) if length <= PACKET_LIMIT else b""
        if len(data) < length:
            report.damaged(f"the file breaks off or is wrong after {count(done, 'record')}")
            return
        done += 1
        yield *said, data


def cut(data: Any, at: int, head: struct.Struct) -> tuple[Any, int]:
    """What stands behind its length at a place of a record, and the place after it."""
    if len(data) - at < head.size:
        raise Damaged("half a record at its end")
    (length,) = head.unpack_from(data, at)
    end = at + head.size + length
    if end > len(data):
        raise Damaged("a record runs beyond its end")
    return data[at + head.size : end], end


def refuse_packed(path: Path) -> None:
    """Raise where the whole file is packed: formats that are read by seeking must be unpacked first."""
    if (packing := compression(path)) is not None:
        tool = _PACKED.get(path.suffix.lower(), packing + " -d")
        what, do = f"the whole file is packed with {packing}", f"unpack it first: {tool} {path.name}"
        raise FormatError(what, where=path, do=do)


def unpack(packing: str, packed: bytes, size: int) -> bytes:
    """``size`` bytes of a piece of a file, never more than it states, and never more than ``LIMIT``.
    :class:`Damaged` where the packing is unknown or broken, or the length differs."""
    if size > LIMIT:
        raise Damaged(f"it states {size:,} bytes")
    data = packed
    if packing in ("zstd", "lz4", "bz2"):
        try:
            data = pa.CompressedInputStream(pa.BufferReader(packed), packing).read(size + 1)
        except (OSError, pa.ArrowException) as error:
            raise Damaged(f"its {packing} packing is broken: {error}") from None
    elif packing not in ("", "none"):
        raise Damaged(f"unknown packing {packing!r}")
    if len(data) != size:
        raise Damaged("its length is wrong")
    return data
