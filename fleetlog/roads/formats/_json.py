"""A map file that is JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fleetlog.errors import SiteError


def read_json(path: Path) -> Any:
    """What a file says, or a :class:`SiteError` that names the line."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except json.JSONDecodeError as error:
        raise SiteError(
            f"not valid JSON: {error.msg}", where=path, place=f"line {error.lineno}", do="correct the file"
        ) from None
    except (UnicodeDecodeError, RecursionError) as error:
        raise SiteError(f"not readable as JSON: {type(error).__name__}", where=path) from None
