"""How mkdocstrings reads this project's docstrings: ``name : description`` on one line, types from annotations."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

SECTIONS = ("Parameters", "Attributes", "Raises", "Returns")
ITEM = re.compile(r"^(\w[\w, *]*) : (.*)$")


class Descriptions(Extension):
    """Move the description of a parameter to a line of its own, where numpydoc expects it."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring is not None:
            obj.docstring.value = rewritten(obj.docstring.value)


def rewritten(text: str) -> str:
    """The docstring with every description below its name."""
    out, inside = [], False
    lines = text.splitlines()
    for number, line in enumerate(lines):
        after = lines[number + 1] if number + 1 < len(lines) else ""
        if after and not after.strip("-"):
            inside = line in SECTIONS
        found = ITEM.match(line) if inside else None
        if found:
            out += [found[1], f"    {found[2]}"]
        else:
            out.append(line)
    return "\n".join(out)
