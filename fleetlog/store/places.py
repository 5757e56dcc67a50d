"""Where datasets lie: a folder, or a URL that fsspec opens (``s3://``, ``gs://``, ``az://``)."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fleetlog import scratch
from fleetlog.errors import InputError, OutputError

EXTRA = {"s3": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "az": "adlfs", "abfs": "adlfs"}
"""What opens the addresses of each kind."""


def is_url(path: Any) -> bool:
    """Return whether a name is an address and not a file of this machine."""
    return "://" in str(path)


def located(path: str | Path) -> Path:
    """The path of a file or a folder; of a URL, an object that is used like one."""
    if not is_url(path):
        return Path(path)
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


@contextmanager
def uploaded(target: Any, *, overwrite: bool = False, new: bool = True) -> Iterator[Path]:
    """A folder of this machine whose files are put under the URL ``target`` when the block ends well.

    ``dataset.json`` is put last: until then there is no dataset, or the older one.  ``new``: there must be
    none, since objects cannot be exchanged at once.
    """
    if overwrite or (new and (target / "dataset.json").exists()):
        what = "a dataset behind a URL is not replaced" if overwrite else "is already there"
        raise OutputError(what, where=str(target), do="choose another name, or remove it yourself")
    with tempfile.TemporaryDirectory(dir=scratch.folder()) as folder:
        yield Path(folder)
        _upload(Path(folder), target)


def _upload(folder: Path, target: Any) -> None:
    files = sorted((p for p in folder.rglob("*") if p.is_file()), key=lambda p: (p.name == "dataset.json", p))
    done = []
    try:
        for file in files:
            where = target / file.relative_to(folder).as_posix()
            done.append(where)
            where.fs.put_file(str(file), where.path)
    except BaseException as error:
        for where in done:  # of an older dataset nothing is replaced before its rows are there
            if where.name.startswith("part-"):
                with suppress(Exception):
                    where.unlink()
        if isinstance(error, OSError):
            what = f"cannot be written ({error})"
            raise OutputError(what, where=str(target), do="check the rights") from None
        raise
