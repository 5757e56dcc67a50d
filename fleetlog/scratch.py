"""The folder for what a process needs until it ends; it goes with the process, however that ends.

The process locks the folder, and marks it then; the kernel lets the lock go with the process.  So a marked
folder that nobody holds is that of a dead one, and whoever makes a folder removes it."""

import os
import secrets
import shutil
import stat
import tempfile
from contextlib import suppress
from multiprocessing.util import Finalize
from pathlib import Path

PREFIX, MARK = "fleetlog-", ".fleetlog-scratch"
_made: list[tuple[Path, int]] = []  # The folders of this process, and its number: a fork has none


def folder() -> Path:
    """A new empty folder within that of this process."""
    if not _made or _made[-1][1] != os.getpid() or not _made[-1][0].is_dir():
        sweep()
        own = Path(tempfile.gettempdir()) / f"{PREFIX}{secrets.token_hex(8)}"
        # Known before it is there: a worker may be told to end at any moment, and has no atexit.
        _made.append((own, os.getpid()))
        Finalize(None, clear, exitpriority=0)
        own.mkdir(mode=0o700)
        if _hold(own) is not None:
            (own / MARK).touch()
    return Path(tempfile.mkdtemp(dir=_made[-1][0]))


def clear() -> None:
    """Remove the folders of this process; it does so by itself where it ends as Python means it to."""
    for own, process in _made:
        if process == os.getpid():
            shutil.rmtree(own, ignore_errors=True)


def sweep() -> None:
    """Remove the folders of dead processes of this user: real ones, marked and held by nobody."""
    for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):
            mark = (path / MARK).lstat()
            if stat.S_ISREG(mark.st_mode) and (lock := _hold(path)) is not None:
                # shutil follows no link, be it that one took the folder's place.
                shutil.rmtree(path, ignore_errors=True)
                os.close(lock)


def _hold(path: Path) -> int | None:
    """The lock on a folder of this user (a link is none); None where another process has it."""
    try:
        import fcntl

        lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except (ImportError, OSError):
        return None
    with suppress(OSError):
        if os.fstat(lock).st_uid == os.getuid():
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
    os.close(lock)
    return None
