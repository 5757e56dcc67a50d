"""The one way to JSON: no NaN, no infinity, unknown is null; and where a result came from."""

import hashlib
import json
import shlex
import sys
from collections.abc import Iterable
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.site import Site
from fleetlog.version import __version__

ENGINE = ("--workers", "--scheduler")  # Options that say where jobs run: no result depends on them


def plain(value: Any) -> Any:
    """JSON-ready: numpy scalars and arrays to Python's own; NaN, infinity and missing times to null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, date):
        return None if value != value else value.isoformat()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def json_text(value: Any, indent: int | None = None) -> str:
    """``value`` as JSON that every reader takes (RFC 8259)."""
    return json.dumps(plain(value), indent=indent, allow_nan=False)


def write_json(path: Path, value: Any, indent: int | None = None) -> None:
    """Write ``value`` as a JSON file with a last line end."""
    path.write_text(json_text(value, indent) + "\n", encoding="utf-8")


def digest(path: Path) -> str:
    """The SHA-256 of a file in hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def provenance(
    inputs: Iterable[Path] = (), seed: int | None = None, site: Site | None = None, **more: Any
) -> dict[str, Any]:
    """Command line, version, inputs with their digests, seed. A dataset among the inputs is told by its
    description, a ``site`` by the files that it was read from."""
    told = [p / "dataset.json" if (p / "dataset.json").is_file() else p for p in inputs]
    named = ((f"{p.parent.name}/{p.name}" if p.name == "dataset.json" else p.name, p) for p in told)
    files = [{"file": n, "bytes": p.stat().st_size, "sha256": digest(p)} for n, p in named if p.is_file()]
    known = {f["sha256"] for f in files}
    sources = [] if site is None else [s for s in site.source.values() if s["sha256"] not in known]
    files += [{"file": s["file"], "sha256": s["sha256"]} for s in sources]
    given = zip(sys.argv[1:], ["", *sys.argv[1:]], strict=False)
    words = (w for w, before in given if before not in ENGINE and w.partition("=")[0] not in ENGINE)
    command = shlex.join(["fleetlog", *words])
    return {"command": command, "version": __version__, "inputs": files, "seed": seed, **more}
