"""Files from outside: only regular ones are opened, those that are held whole only up to a size; URLs."""

import gzip
import os
import stat
import zlib
from pathlib import Path
from typing import Any, BinaryIO

from fleetlog.errors import InputError

WHOLE = 1 << 28  # Bytes of a map that is held whole
SETTINGS = 1 << 24  # Bytes of a file of settings (TOML)
HERE = "file://"
EXTRA = {"s3": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "az": "adlfs", "abfs": "adlfs"}
"""What opens the addresses of each kind."""


def open_regular(path: Path, error: type[InputError] = InputError) -> BinaryIO:
    """Open a regular file for reading; ``error`` for anything else, without waiting on a pipe."""
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as problem:
        why = getattr(problem, "strerror", None) or str(problem)
        raise error(why, where=path, do="check the name and the rights") from None
    mode = os.fstat(handle).st_mode
    if not stat.S_ISREG(mode):
        os.close(handle)
        what = "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device"
        raise error(f"is {what}, not a regular file", where=path, do="save what it gives to a file first")
    return os.fdopen(handle, "rb")


def read_whole(path: Path, limit: int = WHOLE, error: type[InputError] = InputError) -> bytes:
    """All bytes of a regular file of at most ``limit`` bytes, unpacked where it is packed with gzip."""
    if len(data := read_head(path, limit + 1, error)) > limit:
        raise error(f"is larger than {limit >> 20} MB", where=path, do="cut it to what is needed")
    return data


def read_head(path: Path, size: int, error: type[InputError] = InputError) -> bytes:
    """The first bytes of a regular file, unpacked where it is packed with gzip."""
    with open_regular(path, error) as stream:
        packed = stream.read(2) == b"\x1f\x8b"
        stream.seek(0)
        try:
            return (gzip.GzipFile(fileobj=stream) if packed else stream).read(size)
        except (EOFError, gzip.BadGzipFile, zlib.error) as problem:
            raise error(f"is a damaged gzip file ({problem})", where=path, do="pack it again") from None


def is_url(path: Any) -> bool:
    """Return whether a name is an address and not a file of this machine (``file://`` is one)."""
    return "://" in str(path) and not str(path).startswith(HERE)


def located(path: str | Path) -> Path:
    """The path of a file or a folder; of a URL, an object that is used like one."""
    if not is_url(path):
        return Path(str(path).removeprefix(HERE))
    if not isinstance(path, str):
        return path
    kind = path.partition("://")[0]
    try:
        from upath import UPath

        where: Any = UPath(path.rstrip("/"))
        where.fs.invalidate_cache()
    except (ImportError, ValueError) as error:
        what = f"addresses of the kind {kind}:// cannot be opened ({error})"
        do = f"pip install 'fleetlog[cloud]' {EXTRA.get(kind, '')}".rstrip()
        raise InputError(what, where=path, do=do) from None
    return where  # type: ignore[no-any-return]  # it quacks
