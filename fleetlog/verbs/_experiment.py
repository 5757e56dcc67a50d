"""Simulations with settings that vary: the file of an experiment, and its answer."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from fleetlog.core.schema import load_toml
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
    table = load_toml(path)
    if not isinstance(vary := table.pop("vary", {}), dict):
        raise ArgumentError(f"{path}: vary is not a table", option="--experiment", do="write [vary]")
    table = {name.replace("-", "_"): _as_typed(value) for name, value in table.items()}
    known = {o.name: o for o in simulate.options}  # type: ignore[attr-defined]
    for name, value in table.items():
        if name not in known:
            what = f"{path}: unknown key {name!r}; {nearest(name, known)}"
            raise ArgumentError(what, option="--experiment")
        if isinstance(value, list) and not known[name].many:
            raise ArgumentError(f"{path}: {name} takes one value", option="--experiment")
    for name in table.keys() & {*FILES}:
        with suppress(OSError, ValueError):  # what cannot be a name is none of a file
            (path.parent / str(table[name])).stat()
            table[name] = str(path.parent / str(table[name]))
    if vary:
        several = {k: v if isinstance(v, list) else [v] for k, v in vary.items()}
        table["vary"] = tuple(f"{k}={','.join(map(str, v))}" for k, v in several.items())
    return {**table, **given}


def _as_typed(value: Any) -> Any:
    """A value as a command line would have it: a text, several, or a flag."""
    if isinstance(value, bool):
        return value
    return [str(v) for v in value] if isinstance(value, list) else str(value)


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
