"""The file of an experiment: arguments of ``simulate``, and which of them vary."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fleetlog.core.schema import load_toml
from fleetlog.errors import ArgumentError, nearest

if TYPE_CHECKING:
    from fleetlog.api.verb import Option

FILES = ("site", "truck", "like", "tasks", "physics")


def settings_file(given: dict[str, Any], options: dict[str, Option]) -> dict[str, Any]:
    """Add the arguments that are not given from the TOML file ``experiment``, if there is one."""
    if given.get("experiment") is None:
        return given
    path, filled = Path(given["experiment"]), dict[str, Any]()
    table = load_toml(path)
    if not isinstance(vary := table.pop("vary", {}), dict):
        raise ArgumentError(f"{path}: vary is not a table", option="--experiment", do="write [vary]")
    for key, value in table.items():
        name, texts = key.replace("-", "_"), _texts(value)
        if name not in options:
            what = f"{path}: unknown key {name!r}; {nearest(name, options)}"
            raise ArgumentError(what, option="--experiment")
        if isinstance(value, list) and not options[name].many:
            raise ArgumentError(f"{path}: {name} takes one value", option="--experiment")
        filled[name] = value if options[name].flag else texts if options[name].many else texts[0]
        if name in FILES:
            with suppress(OSError, ValueError):  # what cannot be a name is none of a file
                (path.parent / texts[0]).stat()
                filled[name] = str(path.parent / texts[0])
    if vary:
        filled["vary"] = [f"{name}={','.join(_texts(values))}" for name, values in vary.items()]
    return {**filled, **given}


def _texts(value: Any) -> list[str]:
    """A value, or several, as a command line would have them."""
    return [str(v) for v in (value if isinstance(value, list) else [value])]
