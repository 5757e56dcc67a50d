"""Files as bytes, whether packed or not; a packed file that is cut off or broken gives what is whole."""

from __future__ import annotations

import bz2
import io
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fleetlog.core.files import open_regular
from fleetlog.core.words import count
from fleetlog.errors import FormatError
from fleetlog.importers._report import ReadReport

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

HEAD = 1 << 16
RATIO = 250
"""A packed file that gives more than this many times its size is a bomb, beyond the first ``FREE`` bytes."""
FREE = 1 << 26
LARGEST = 1 << 38
"""Unpacked bytes of one file."""
_PIECE, _SIP = 1 << 16, 1 << 10
_MAGIC = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"BZh": "bzip2"}
_PACKED = {".gz", ".zst", ".bz2"}


def plain_suffix(path: Path) -> str:
    """The suffix in lower case, that of the compression taken off: ``.csv`` of ``a.CSV.gz``."""
    suffixes = [s.lower() for s in path.suffixes]
    if len(suffixes) > 1 and suffixes[-1] in _PACKED:
        suffixes.pop()
    return suffixes[-1] if suffixes else ""


def plain_stem(path: Path) -> str:
    """The file's name without its suffixes of format and compression: ``truck.7`` of ``truck.7.csv.gz``."""
    name = path.name
    if path.suffix.lower() in _PACKED:
        name = Path(name).stem
    return Path(name).stem


def compression(path: Path) -> str | None:
    """``gzip``, ``zstd``, ``bzip2`` or None, from the first bytes."""
    if path.is_dir():
        return None
    with open_regular(path) as stream:
        magic = stream.read(4)
    return next((name for sign, name in _MAGIC.items() if magic.startswith(sign)), None)


class Unpacked(io.RawIOBase):
    """The bytes of a file, unpacked piece by piece; ``share`` says how far the file itself has been read.

    Where the packing is cut off or broken, the stream ends there, with everything before it, and ``report``
    hears of it.
    """

    def __init__(self, path: Path, report: ReadReport | None = None) -> None:
        self.path = path
        self._packing = compression(path)
        self._file = open_regular(path)
        self._size = max(path.stat().st_size, 1)
        self._report = report
        self._given = 0
        self._ready = self._waiting = b""
        self._unpacker: Any = None

    @property
    def share(self) -> float:
        """Share of the file that has been read, 0 to 1."""
        return min(self._file.tell() / self._size, 1.0) if not self._file.closed else 1.0

    def readable(self) -> bool:
        """True."""
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        """The next bytes; 0 at the end, and at the first damage."""
        view = memoryview(buffer).cast("B")
        if not self._ready:
            self._ready = self._unpacked(len(view)) if self._packing else self._file.read(len(view))
        data, self._ready = self._ready[: len(view)], self._ready[len(view) :]
        view[: len(data)] = data
        self._given += len(data)
        if self._packing and self._given > min(max(FREE, RATIO * self._size), LARGEST):
            what = f"unpacks to more than {self._given >> 20} MB, from {self._size:,} bytes"
            raise FormatError(what, where=self.path, do="if that is meant, unpack it first")
        return len(data)

    def _unpacked(self, size: int) -> bytes:
        """Some unpacked bytes, empty at the end; packed streams may follow one another."""
        while True:
            more = self._waiting or not getattr(self._unpacker, "needs_input", True)
            packed = self._waiting if more else self._file.read(_PIECE)
            if self._unpacker is None:
                packed = packed.lstrip(b"\0")
                if not packed:
                    return b""
                self._unpacker = _unpacker(str(self._packing))
            try:
                data, self._waiting = _step(self._unpacker, str(self._packing), packed, size)
            except Exception as error:  # each library has its own family of errors
                return self._broken(str(error))
            if self._unpacker.eof:
                self._unpacker = None
            elif not data and not packed:
                return self._broken("it ends too early")
            if data:
                return bytes(data)

    def _broken(self, why: str) -> bytes:
        self._unpacker, self._waiting = None, b""
        self._file.seek(0, io.SEEK_END)
        if self._report is not None:
            at = count(self._given, "byte")
            what = f"the {self._packing} packing is broken or cut off"
            self._report.damaged(f"{what} after about {at} of unpacked log ({why})")
        return b""

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _unpacker(packing: str) -> Any:
    if packing == "gzip":
        return zlib.decompressobj(wbits=31)
    if packing == "bzip2":
        return bz2.BZ2Decompressor()
    import zstandard

    return zstandard.ZstdDecompressor(max_window_size=1 << 27).decompressobj()


def _step(unpacker: Any, packing: str, packed: bytes, size: int) -> tuple[bytes, bytes]:
    """About ``size`` unpacked bytes, however far the packing swells, and the input that is left."""
    if packing == "zstd":
        # The library bounds no output; a piece this small holds blocks of 32 MB in all at most.
        data = unpacker.decompress(packed[:_SIP])
        return data, unpacker.unused_data + packed[_SIP:]
    data = unpacker.decompress(packed, size)
    return data, unpacker.unused_data or getattr(unpacker, "unconsumed_tail", b"")


def open_bytes(path: Path, report: ReadReport | None = None) -> tuple[io.BufferedReader, Unpacked]:
    """A buffered stream of the unpacked bytes, and the raw one below, which knows the share read."""
    raw = Unpacked(path, report)
    return io.BufferedReader(raw, 1 << 20), raw


def head_of(path: Path, size: int = HEAD) -> bytes:
    """The first bytes, unpacked; ``b""`` for a folder."""
    if path.is_dir():
        return b""
    stream, _ = open_bytes(path)
    with stream:
        return stream.read(size)
