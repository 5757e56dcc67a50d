"""Unpacking what came from outside: never more than it states, and never more than a limit."""

import bz2
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._open import compression

LIMIT = 1 << 28
"""Bytes of one packed piece, before or after unpacking, that are believed."""


class Damaged(Exception):
    """A stretch of the file cannot be read."""


def refuse_packed(path: Path) -> None:
    """Raise where the whole file is packed: formats that are read by seeking must be unpacked first."""
    packing = compression(path)
    if packing is not None:
        tool = {"gzip": "gunzip", "zstd": "zstd -d", "bzip2": "bunzip2"}[packing]
        what, do = f"the whole file is packed with {packing}", f"unpack it first: {tool} {path.name}"
        raise FormatError(what, where=path, do=do)


def unpack(packing: str, packed: bytes, size: int) -> bytes:
    """``size`` bytes; :class:`Damaged` where the packing is unknown or broken, or the length differs."""
    if size > LIMIT:
        raise Damaged(f"it states {size:,} bytes")
    try:
        data = _unpack(packing, packed, size)
    except Damaged:
        raise
    except Exception as error:  # each library has its own family of errors
        raise Damaged(f"its {packing} packing is broken: {error}") from None
    if len(data) != size:
        raise Damaged("its length is wrong")
    return data


def _unpack(packing: str, packed: bytes, size: int) -> bytes:
    if packing in ("", "none"):
        return packed
    if packing == "zstd":
        import zstandard

        return bytes(zstandard.ZstdDecompressor().stream_reader(packed).read(size + 1))
    if packing == "lz4":
        import lz4.frame

        decoder: Any = lz4.frame.LZ4FrameDecompressor()
        return bytes(decoder.decompress(packed, max_length=size + 1))
    if packing == "bz2":
        return bz2.BZ2Decompressor().decompress(packed, size + 1)
    raise Damaged(f"unknown packing {packing!r}")
