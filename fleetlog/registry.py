"""A folder is a list of parts.

Every importer, map format, physics term, analysis and exporter is one module of a package; the module holds
one object under an agreed name (``IMPORTER``, ``READER``, ``TERM``, ``ANALYSIS``, ``EXPORTER``).  Adding a
part is adding a file.  Other distributions add parts through entry points of the group ``fleetlog.<package>``
(for example ``fleetlog.physics.terms``), each naming such an object.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from importlib.metadata import entry_points
from typing import Any


def part_names(package: str) -> list[str]:
    """Module names of the parts in ``package``, sorted, without importing them;
    ``_private`` modules are no parts.
    """
    folder = importlib.import_module(package)
    return sorted(m.name for m in pkgutil.iter_modules(folder.__path__) if not m.name.startswith("_"))


@cache
def parts(package: str, attribute: str) -> dict[str, Any]:
    """All parts of ``package`` by name: the object ``attribute`` of every module that has one, then entry
    points.

    The name of a part is its ``name`` attribute, or the module's where it has none.
    """
    found: dict[str, Any] = {}
    for module_name in part_names(package):
        part = getattr(importlib.import_module(f"{package}.{module_name}"), attribute, None)
        if part is not None:
            found[getattr(part, "name", module_name)] = part
    for entry in sorted(entry_points(group=package), key=lambda e: e.name):
        part = entry.load()
        found.setdefault(getattr(part, "name", entry.name), part)
    return found
