"""Names as SUMO allows them."""

from __future__ import annotations

import re

_FORBIDDEN = re.compile(r"[\s|\\'\";,<>&!#%]")


def sumo_name(name: str) -> str:
    """``name`` without the characters that SUMO's ids must not have."""
    clean = _FORBIDDEN.sub("_", name)
    return "_" + clean if clean.startswith(":") or not clean else clean
