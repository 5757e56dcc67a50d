"""Files as bytes, whether packed or not; a packed file that is cut off or broken gives what is whole."""

from __future__ import annotations

import io
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from fleetlog.errors import InputError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

    from fleetlog.importers.base import ReadReport

HEAD = 1 << 16
_PIECE = 1 << 17
_MAGIC = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd"}
_PACKED = {".gz", ".zst"}


def plural(count: int, noun: str) -> str:
    """``1 row``, ``2,000 rows``."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


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
    """``gzip``, ``zstd`` or None, from the first bytes."""
    if path.is_dir():
        return None
    with _opened(path) as stream:
        magic = stream.read(4)
    return next((name for sign, name in _MAGIC.items() if magic.startswith(sign)), None)


def _opened(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise InputError(
            error.strerror or str(error), where=path, do="check the name and the rights"
        ) from None


class Unpacked(io.RawIOBase):
    """The bytes of a file, unpacked; ``share`` says how far the file itself has been read.

    Where the packing is cut off or broken, the stream ends there, with everything before it, and ``report`` hears of it.
    """

    def __init__(self, path: Path, report: ReadReport | None = None) -> None:
        self._packing = compression(path)
        self._file = _opened(path)
        self._size = max(path.stat().st_size, 1)
        self._report = report
        self._given = 0
        self._ready = b""
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
        while not self._ready:
            packed = self._file.read(_PIECE)
            if not packed:
                if self._unpacker is not None:
                    self._broken("it ends too early")
                return 0
            self._ready = self._unpacked(packed) if self._packing else packed
        data, self._ready = self._ready[: len(view)], self._ready[len(view) :]
        view[: len(data)] = data
        self._given += len(data)
        return len(data)

    def _unpacked(self, packed: bytes) -> bytes:
        """What a piece of the file gives; packed streams may follow one another."""
        out = []
        while packed:
            if self._unpacker is None:
                self._unpacker = _unpacker(self._packing)
            try:
                out.append(self._unpacker.decompress(packed))
            except Exception as error:
                if not isinstance(error, zlib.error) and type(error).__name__ != "ZstdError":
                    raise
                self._broken(str(error))
                self._file.seek(0, io.SEEK_END)
                self._unpacker = None
                break
            packed = b""
            if self._unpacker.eof:
                packed, self._unpacker = self._unpacker.unused_data.lstrip(b"\0"), None
        return b"".join(out)

    def _broken(self, why: str) -> None:
        self._unpacker = None
        if self._report is not None:
            at = plural(self._given, "byte")
            self._report.damaged(
                f"the {self._packing} packing is broken or cut off after about {at} of unpacked log ({why})"
            )

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _unpacker(packing: str | None) -> Any:
    if packing == "gzip":
        return zlib.decompressobj(wbits=31)
    import zstandard

    return zstandard.ZstdDecompressor().decompressobj()


def open_bytes(path: Path, report: ReadReport | None = None) -> tuple[io.BufferedReader, Unpacked]:
    """A buffered stream of the unpacked bytes, and the raw one below it, which knows the share that was read."""
    raw = Unpacked(path, report)
    return io.BufferedReader(raw, 1 << 20), raw


def head_of(path: Path, size: int = HEAD) -> bytes:
    """The first bytes, unpacked; ``b""`` for a folder."""
    if path.is_dir():
        return b""
    stream, _ = open_bytes(path)
    with stream:
        return stream.read(size)
