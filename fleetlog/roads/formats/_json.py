"""A map file that is JSON."""

import json
from pathlib import Path
from typing import Any

from fleetlog.core.files import read_whole
from fleetlog.errors import SiteError


def read_json(path: Path) -> Any:
    """What a file says, or a :class:`SiteError` that names the line."""
    data = read_whole(path, error=SiteError)
    try:
        return json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        what = f"not valid JSON: {error.msg}"
        raise SiteError(what, place=f"line {error.lineno}", do="correct the file") from None
    except (ValueError, RecursionError) as error:
        raise SiteError(f"not readable as JSON: {str(error)[:120]}", do="correct the file") from None
