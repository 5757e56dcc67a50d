"""Where results go: whole or not at all, and never over anything but an older output of the same kind.

A run works in the hidden folder ``.NAME.partial`` beside its target and holds a lock in it, which the kernel
releases however the run ends; whoever finds the folder unlocked knows that its run is dead.  Every folder of
output carries a :data:`MARK` that says what was written into it; a single file has its mark beside it."""

import ctypes
import errno
import json
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fleetlog import interrupt
from fleetlog.core.files import is_url
from fleetlog.errors import OutputError
from fleetlog.store.documents import digest, write_json
from fleetlog.version import __version__

MARK = ".fleetlog"
"""In a folder: its kind, the version, the names in it.  ``.NAME.fleetlog`` beside a file: kind, digest."""
PARTIALS = ".partials"  # In a dataset: partial results of questions asked of it
REMADE = frozenset({MARK, "recording.rrd", ".recording.rrd.partial", PARTIALS})
"""Names in an output that fleetlog may add later."""
NOREPLACE, EXCHANGE = 1, 2
_held: set[int] = set()  # Descriptors of the locks of this process
AT_FDCWD = -100
NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)


@contextmanager
def atomic_output(
    target: str | Path, kind: str, *, overwrite: bool = False, folder: bool = True,
    inputs: Iterable[Path] = (),
) -> Iterator[Path]:  # fmt: skip
    """A scratch folder (or the name of a scratch file) that becomes ``target`` when the block ends well.

    target : a folder or a file; missing folders above it are made; of a symlink, what it names is written.
    kind : what is written, a noun; an older output is replaced by one of the same kind only.
    overwrite : whether an older output may be replaced; it is, at once, when the new one is whole.
    inputs : files and folders that the run reads.

    :class:`OutputError` where it must not be replaced (:func:`check_free`) or another run writes to it."""
    given, inputs = target, list(inputs)
    target = check_free(given, kind, overwrite=overwrite, folder=folder, inputs=inputs)
    interrupt.keep_from_arrow()
    with _parents(target), _claimed(target) as scratch:
        new = scratch / "new"
        if folder:
            new.mkdir()
        try:
            yield new
        except OSError as error:
            if error.filename is not None or error.errno not in NO_ROOM:
                raise
            # Libraries that write leave the name of the output out.
            what, do = f"not written: {os.strerror(error.errno)}", "make room or write to another disk"
            raise OutputError(what, where=given, do=do) from error
        mark = _mark(new, kind, target)
        _sync(new)
        with interrupt.held():
            check_free(given, kind, overwrite=overwrite, folder=folder, inputs=inputs)
            if mark is not None:
                mark.replace(_mark_of(target))
            _swap(new, target)


@contextmanager
def remade(part: Path) -> Iterator[Path]:
    """The name of a scratch file that replaces ``part``, fleetlog's own, when the block ends well."""
    with _claimed(part) as scratch:
        yield scratch / "new"
        _sync(scratch / "new")
        (scratch / "new").replace(part)


def share(source: Path, target: Path) -> None:
    """Make ``target`` a folder with the files of ``source``: hard links, or copies where there are none."""

    def linked(one: str, other: str) -> None:
        try:
            os.link(one, other)
        except OSError:
            shutil.copy2(one, other)

    if source.is_dir():
        shutil.copytree(source, target, copy_function=linked)


def check_free(
    target: str | Path, kind: str, *, overwrite: bool, folder: bool = True, inputs: Iterable[Path] = ()
) -> Path:
    """Return where ``target`` really is; raise :class:`OutputError` if it is a URL or is read by the run, or
    is there and must not be replaced.
    ``overwrite`` replaces a folder or a regular file that carries the mark of an older output of this
    ``kind``, holds nothing else (a folder) and was not changed since (a file); an empty folder too."""
    if is_url(given := target):
        raise OutputError("only datasets are written to a URL", where=str(given), do="name a file or folder")
    target = Path(os.path.realpath(target))
    for source in inputs:
        if not is_url(source) and (why := _at_input(target, source)) is not None:
            raise OutputError(why, where=given, do="choose another name")
    try:
        mode = target.lstat().st_mode
    except FileNotFoundError:
        return target
    if not (stat.S_ISDIR(mode) or stat.S_ISREG(mode)):
        raise OutputError("is a device, a pipe or a socket", where=given, do="name a file or a folder")
    if stat.S_ISDIR(mode) != folder:
        is_, wanted = ("file", "folder") if folder else ("folder", "file")
        what = f"is a {is_}, and a {wanted} is to be written"
        raise OutputError(what, where=given, do="choose another name")
    if not overwrite:
        raise OutputError("is already there", where=given, do="choose another name or add --overwrite")
    if (why := _foreign(target, kind)) is not None:
        do = "choose another name or remove it yourself"
        raise OutputError(f"{why}; it is not replaced", where=given, do=do)
    return target


def _at_input(target: Path, given: Path) -> str | None:
    """Why an output is not apart from an input: at it, above it, or inside a dataset; None where it is."""
    source = Path(os.path.realpath(given))

    def same(a: Path, b: Path) -> bool:
        return a.exists() and b.exists() and a.samefile(b)

    if same(target, source):
        return "is what this run reads"
    if any(same(target, folder) for folder in source.parents):
        return f"holds {given}, which this run reads"
    if (source / "dataset.json").is_file() and any(same(source, folder) for folder in target.parents):
        return f"lies in the dataset {given}, which this run reads"
    return None


def _foreign(target: Path, kind: str) -> str | None:
    """Why an existing output is not to be replaced by one of this kind; None where it is."""
    folder = target.is_dir()
    names = set(_names(target)) if folder else set()
    if folder and not names:
        return None
    try:
        mark: dict[str, Any] = json.loads(_mark_of(target).read_bytes())
        made, known = str(mark["kind"]), set(mark["names" if folder else "sha256"])
    except (OSError, ValueError, TypeError, KeyError):
        return "was not made by fleetlog"
    if made != kind:
        return f"is the output of another command ({made}, not {kind})"
    if not folder and digest(target) not in known:
        return "was changed since fleetlog wrote it"
    more = sorted(names - known - REMADE)
    return f"holds {more[0]!r}, which fleetlog did not write" if more else None


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def _mark_of(target: Path) -> Path:
    return target / MARK if target.is_dir() else target.with_name(f".{target.name}{MARK}")


def _mark(new: Path, kind: str, target: Path) -> Path | None:
    """Mark the new output; a file's mark is returned, to be put beside it. It names the older file too, so
    that both are known at every instant."""
    if new.is_dir():
        write_json(new / MARK, {"kind": kind, "version": __version__, "names": sorted(_names(new))})
        return None
    mark = new.with_name("mark")
    write_json(mark, {"kind": kind, "sha256": [digest(p) for p in (new, target) if p.is_file()]})
    return mark


def _sync(new: Path) -> None:
    """Bring a file, or all files of a folder, to the disk: some file systems report a full one only then."""
    for path in new.rglob("*") if new.is_dir() else (new,):
        if path.is_file():
            with path.open("rb") as stream:
                os.fsync(stream.fileno())


@contextmanager
def _parents(target: Path) -> Iterator[None]:
    """Make the folders above ``target``; a run that fails takes away again those that were missing."""
    missing = [p for p in target.parents if not p.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        with suppress(OSError):
            for folder in missing:
                folder.rmdir()
        raise


@contextmanager
def _claimed(target: Path) -> Iterator[Path]:
    """The scratch folder of ``target``, held by a lock and cleared of what a dead run left."""
    scratch = target.with_name(f".{target.name}.partial")
    with interrupt.held():
        lock = _lock(scratch, target)
    try:
        interrupt.check()
        _clear(scratch, target)
        yield scratch
    finally:
        _clear(scratch, target)
        with suppress(OSError):
            (scratch / "lock").unlink()
            scratch.rmdir()
        _let_go({lock})


def _let_go(locks: set[int]) -> None:
    for lock in locks & _held:
        os.close(lock)
    _held.difference_update(locks)


if hasattr(os, "register_at_fork"):  # a worker that outlives a killed run must not hold its place
    os.register_at_fork(after_in_child=lambda: _let_go(set(_held)))


def _lock(scratch: Path, target: Path) -> int:
    """Make the scratch folder and lock it; the descriptor of the lock."""
    import fcntl

    while True:
        with suppress(FileNotFoundError):  # the run that held it has just ended and takes its folder away
            scratch.mkdir(exist_ok=True)
            if (names := _names(scratch)) and "lock" not in names:
                raise OutputError("is in the way", where=scratch, do="move it away or choose another output")
            lock = os.open(scratch / "lock", os.O_RDWR | os.O_CREAT, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(lock).st_ino == (scratch / "lock").stat().st_ino:
                    _held.add(lock)
                    return lock
            except BlockingIOError:
                what, do = "another run is writing to it", "wait for it or choose another name"
                raise OutputError(what, where=target, do=do) from None
            except OSError as error:
                if isinstance(error, FileNotFoundError):
                    raise
                what, do = f"cannot be locked here ({error.strerror})", "write to another disk and copy it"
                raise OutputError(what, where=target, do=do) from None
            finally:
                if lock not in _held:
                    os.close(lock)


def _clear(scratch: Path, target: Path) -> None:
    """Empty a scratch folder but for its lock; an older output that was set aside in it goes back."""
    if (old := scratch / "old").exists() and not target.exists():
        old.rename(target)
    for path in scratch.iterdir():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name != "lock":
            path.unlink(missing_ok=True)


def _swap(new: Path, target: Path) -> None:
    """Put ``new`` in the place of ``target``: the older or the newer one is there at every instant. Where the
    system cannot exchange two folders, the older one is set aside in the scratch folder for a moment; a run
    that dies in it leaves it there, and the next one to this target puts it back."""
    older = os.path.lexists(target)
    if target.is_file():
        new.replace(target)
    elif not _renameat2(new, target, EXCHANGE if older else NOREPLACE):
        if older:
            target.rename(new.with_name("old"))
        new.rename(target)


def _renameat2(source: Path, target: Path, flag: int) -> bool:
    """Rename with a flag of Linux; False where the system or the file system does not know it."""
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    if call(AT_FDCWD, os.fsencode(source), AT_FDCWD, os.fsencode(target), flag) == 0:
        return True
    if (code := ctypes.get_errno()) in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code), str(target))
