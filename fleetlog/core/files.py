"""Files from outside: only regular ones are opened, and those that are held whole only up to a size."""

import gzip
import os
import stat
import zlib
from pathlib import Path
from typing import BinaryIO

from fleetlog.errors import InputError

WHOLE = 1 << 28  # Bytes of a map that is held whole
SETTINGS = 1 << 24  # Bytes of a file of settings (TOML)


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
