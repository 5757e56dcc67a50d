"""Where datasets lie: a folder, or a URL that fsspec opens (``s3://``, ``gs://``, ``az://``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fleetlog.errors import InputError

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
        _ = where.fs
    except (ImportError, ValueError) as error:
        what = f"addresses of the kind {kind}:// cannot be opened ({error})"
        do = f"pip install 'fleetlog[cloud]' {EXTRA.get(kind, '')}".rstrip()
        raise InputError(what, where=path, do=do) from None
    return where  # type: ignore[no-any-return]  # it quacks
