"""A folder is a list of parts.

Every importer, map format, physics term, analysis and exporter is one module of a package; the module holds
one object under an agreed name: ``IMPORTER``, ``READER``, ``TERM``, of an exporter the function ``write``, of
an analysis the function of the module's name.  Adding a part is adding a file.  Other distributions add parts
through entry points of the group ``fleetlog.<package>`` (for example ``fleetlog.physics.terms``), each naming
such an object."""

import ast
import importlib
import importlib.util
import pkgutil
import re
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from fleetlog.errors import InputError


def part_names(package: str) -> list[str]:
    """Module names of the parts in ``package``, without importing them; ``_private`` modules are no parts."""
    modules = pkgutil.iter_modules(importlib.import_module(package).__path__)
    return sorted(m.name for m in modules if not (m.ispkg or m.name.startswith("_")))


@cache
def parts(package: str, attribute: str) -> dict[str, Any]:
    """All parts of ``package``: the object ``attribute`` (empty: that of the module's name) of every module
    that has one, then entry points. The name of a part is its ``name`` attribute, else the module's."""
    found: dict[str, Any] = {}
    for module_name in part_names(package):
        part = getattr(importlib.import_module(f"{package}.{module_name}"), attribute or module_name, None)
        if part is not None:
            found[getattr(part, "name", module_name)] = part
    for entry in entries(package):
        part = _load(entry)
        found.setdefault(getattr(part, "name", entry.name), part)
    return found


def part(package: str, attribute: str, name: str) -> Any:
    """The part called ``name``, importing no other one; KeyError where there is none."""
    if name in part_names(package):
        return getattr(importlib.import_module(f"{package}.{name}"), attribute or name)
    entry = next((e for e in entries(package) if e.name == name), None)
    return parts(package, attribute)[name] if entry is None else _load(entry)


def entries(package: str) -> list[EntryPoint]:
    """The parts that other distributions add, by name, importing none of them."""
    return sorted(entry_points(group=package), key=lambda e: e.name)


def extra(module: str, name: str, what: str, where: Any = None, error: type = InputError) -> Any:
    """The module of the extra ``name``; where it is missing, an ``error`` says ``what`` it is needed for."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise error(what, where=where, do=f'install it with: pip install "fleetlog[{name}]"') from None


def _load(entry: EntryPoint) -> Any:
    """The object of an entry point; one that cannot be loaded is an error that names its distribution."""
    try:
        return entry.load()
    except Exception as error:
        owner = entry.dist.name if entry.dist else "another package"
        what = f"the plug-in {entry.name!r} of {owner} cannot be loaded ({type(error).__name__}: {error})"
        raise InputError(what, do=f"repair or remove {owner}") from error


@cache
def part_lines(package: str, attribute: str) -> dict[str, str]:
    """Every part by name with the first sentence of its module's docstring, importing none of them."""
    lines = {e.name: _sentence(e.module, "") or "" for e in entries(package)}
    own = {m: _sentence(f"{package}.{m}", attribute or m) for m in part_names(package)}
    return lines | {name: line for name, line in own.items() if line is not None}


def _sentence(module: str, attribute: str) -> str | None:
    """The first sentence of a module's docstring, from its source; None where it has no ``attribute``."""
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    source = Path(spec.origin).read_text(encoding="utf-8")
    if attribute and not re.search(rf"^(def )?{attribute}\b", source, re.MULTILINE):
        return None
    return " ".join((ast.get_docstring(ast.parse(source)) or "").split("\n\n")[0].split())
