"""Simulations with settings that vary: the file of an experiment, and its answer."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from fleetlog.errors import ArgumentError, nearest
from fleetlog.listening import progress

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.simulate.scenario import Scenario

FILES = ("site", "truck", "like", "tasks", "physics")


def settings_file(given: dict[str, Any]) -> dict[str, Any]:
    """Add the arguments that are not given from the TOML file ``experiment``, if there is one."""
    if given.get("experiment") is None:
        return given
    from fleetlog.verbs.simulate import simulate

    path = Path(given["experiment"])
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ArgumentError(f"{path}: not readable: {error}", option="--experiment") from None
    table = {name.replace("-", "_"): value for name, value in table.items()}
    vary = table.pop("vary", {})
    known = {o.name for o in simulate.options}  # type: ignore[attr-defined]
    for name in table:
        if name not in known:
            raise ArgumentError(
                f"{path}: unknown key {name!r}; {nearest(name, known)}", option="--experiment"
            )
    for name in FILES:
        if name in table and (path.parent / str(table[name])).exists():
            table[name] = str(path.parent / str(table[name]))
    if vary:
        table["vary"] = tuple(f"{k}={_values(v)}" for k, v in vary.items())
    return {**table, **given}


def _values(value: Any) -> str:
    return ",".join(str(v) for v in value) if isinstance(value, list) else str(value)


def is_experiment(asked: SimpleNamespace) -> bool:
    """Whether more than one run is asked for."""
    return bool(asked.vary) or asked.runs != 1 or isinstance(asked.vehicles, str)


def run_experiment(asked: SimpleNamespace, bases: Sequence[Scenario]) -> Result:
    """Return the answer; ``bases`` has the scenario of each seed."""
    from fleetlog.simulate.experiment import experiment, factor

    factors, fleet = [factor(text) for text in asked.vary], asked.vehicles
    if isinstance(fleet, str) or not factors:
        factors.insert(0, factor(f"vehicles={fleet or bases[0].settings.vehicles}"))
    double = {f.name for f in factors if sum(f.name == g.name for g in factors) > 1}
    if double:
        raise ArgumentError(f"{', '.join(sorted(double))} is varied twice", option="--vary")
    return experiment(bases, factors, lambda done, total: progress("experiment", done / total))
