"""Output appears whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fleetlog.errors import OutputError

MARK = ".partial-"
RESULTS = ("dataset.json", "diagnosis.json", "recording.rrd")
"""What tells a folder that fleetlog made: a dataset, a diagnosis, an analysis."""


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OSError):
        return True
    return True


def _clear_leftovers(target: Path) -> None:
    """Remove what killed runs left beside ``target``."""
    for left in target.parent.glob(f".{target.name}{MARK}*"):
        pid = left.name.rsplit(MARK, 1)[1].split("-")[0]
        if pid.isdigit() and not _alive(int(pid)):
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)


def _ours(folder: Path) -> bool:
    """Whether a folder is empty, was made by fleetlog, or holds nothing but such folders (the demo's)."""
    if any((folder / name).is_file() for name in RESULTS):
        return True
    return all(
        child.is_dir() and any((child / name).is_file() for name in RESULTS) for child in folder.iterdir()
    )


def check_free(target: Path, overwrite: bool, folder: bool = True) -> None:
    """Raise :class:`OutputError` if ``target`` is there and must not be replaced, or cannot be written.

    ``overwrite`` replaces an older output and nothing else: never a folder of the user's own, never a file by a folder.
    """
    if target.exists() and not overwrite:
        raise OutputError("is already there", where=target, do="choose another name or add --overwrite")
    if target.is_dir() and not folder:
        raise OutputError("is a folder; a file is to be written", where=target, do="name a file")
    if target.is_file() and folder:
        raise OutputError("is a file; a folder is to be written", where=target, do="choose another name")
    if target.is_dir() and not _ours(target):
        raise OutputError(
            "was not made by fleetlog and is not replaced", where=target, do="choose another name or empty it"
        )
    if not target.absolute().parent.is_dir():
        raise OutputError("its folder does not exist", where=target, do=f"make {target.parent} first")


@contextmanager
def atomic_output(target: str | Path, *, overwrite: bool = False, folder: bool = True) -> Iterator[Path]:
    """A scratch folder (or file name) beside ``target`` that becomes ``target`` when the block ends well.

    An older ``target`` is only replaced with ``overwrite``, and then only at the end; a killed run leaves nothing but a
    hidden scratch folder, which the next run removes.
    """
    target = Path(target)
    check_free(target, overwrite, folder)
    _clear_leftovers(target)
    scratch = target.parent / f".{target.name}{MARK}{os.getpid()}-{secrets.token_hex(3)}"
    try:
        if folder:
            scratch.mkdir()
        yield scratch
        _swap_in(scratch, target)
    finally:
        if scratch.is_dir():
            shutil.rmtree(scratch, ignore_errors=True)
        else:
            scratch.unlink(missing_ok=True)


def _swap_in(scratch: Path, target: Path) -> None:
    if not target.exists():
        scratch.rename(target)
        return
    if target.is_file():
        scratch.replace(target)
        return
    old = target.parent / f".{target.name}{MARK}{os.getpid()}-old"
    target.rename(old)
    scratch.rename(target)
    shutil.rmtree(old, ignore_errors=True)
