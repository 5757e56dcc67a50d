"""Files as bytes, whether packed or not; a packed file that is cut off or broken gives what is whole."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, cast

from fleetlog.errors import InputError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

    from fleetlog.importers.base import ReadReport

HEAD = 1 << 16
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

    Where the packing is cut off or broken, the stream ends there and ``report`` hears of it.
    """

    def __init__(self, path: Path, report: ReadReport | None = None) -> None:
        self._file = _opened(path)
        self._size = max(path.stat().st_size, 1)
        self._report = report
        self._given = 0
        packing = compression(path)
        self._stream: BinaryIO = self._file
        if packing == "gzip":
            self._stream = cast(BinaryIO, gzip.GzipFile(fileobj=self._file))
        elif packing == "zstd":
            import zstandard

            self._stream = cast(
                BinaryIO, zstandard.ZstdDecompressor().stream_reader(self._file, read_across_frames=True)
            )
        self._packing = packing

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
        try:
            data = self._stream.read(len(view))
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            return self._broken(error)
        except Exception as error:
            if type(error).__name__ != "ZstdError":  # imported only where a file is so packed
                raise
            return self._broken(error)
        view[: len(data)] = data
        self._given += len(data)
        return len(data)

    def _broken(self, error: Exception) -> int:
        if self._report is not None:
            at = plural(self._given, "byte")
            self._report.damaged(
                f"the {self._packing} packing is broken or cut off after {at} of unpacked log ({error})"
            )
        return 0

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


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
