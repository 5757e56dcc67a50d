"""Where a result came from."""

import shlex
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fleetlog.store.documents import digest
from fleetlog.version import __version__

ENGINE = ("--workers", "--scheduler")


def provenance(inputs: Iterable[Path] = (), seed: int | None = None, **more: Any) -> dict[str, Any]:
    """Command line, version, inputs with their digests, seed."""
    files = [{"file": p.name, "bytes": p.stat().st_size, "sha256": digest(p)} for p in inputs if p.is_file()]
    command = shlex.join(["fleetlog", *_that_matter(sys.argv[1:])])
    return {"command": command, "version": __version__, "inputs": files, "seed": seed, **more}


def _that_matter(words: Sequence[str]) -> list[str]:
    """A command line without the options that say where its jobs run: the result does not depend on them."""
    out: list[str] = []
    skip = False
    for word in words:
        if not skip and word.partition("=")[0] not in ENGINE:
            out.append(word)
        skip = not skip and word in ENGINE
    return out
