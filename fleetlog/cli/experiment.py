"""``fleetlog simulate`` with settings that vary: the options of an experiment, its file, and its answer."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fleetlog.cli.options import VEHICLES, existing

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.simulate.scenario import Scenario

F = TypeVar("F", bound=Callable[..., Any])
FILES = ("site", "truck", "like", "tasks", "physics")


class Counts(click.ParamType):  # type: ignore[type-arg]  # generic in newer releases of click only
    """A whole number, or several of them for an experiment: ``6..14``, ``6..14..2``, ``6,8,12``."""

    name = "number or range"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        """The number, or the text of a range as it is."""
        text = str(value).strip()
        if re.fullmatch(r"-?\d+", text):
            return VEHICLES.convert(int(text), param, ctx)
        if not re.fullmatch(r"\d+(\.\.\d+){0,2}(,\d+(\.\.\d+){0,2})*", text):
            self.fail(f"{text!r} is neither a number nor a range; write 8, 6..14 or 6,8,12", param, ctx)
        return text


def _read(ctx: click.Context, param: click.Parameter, path: Path | None) -> Path | None:
    """Take the options that are not given on the command line from the file."""
    if path is None:
        return None
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise click.UsageError(f"{path}: not readable: {error}") from None
    table = {name.replace("-", "_"): value for name, value in table.items()}
    vary = table.pop("vary", {})
    known = {p.name for p in ctx.command.params if p.name}
    for name in table:
        if name not in known:
            from fleetlog.errors import nearest

            raise click.UsageError(f"{path}: unknown key {name!r}; {nearest(name, sorted(known))}")
    for name in FILES:
        if name in table and (path.parent / str(table[name])).exists():
            table[name] = str(path.parent / str(table[name]))
    ctx.default_map = {**table, "vary": [f"{k}={_values(v)}" for k, v in vary.items()]}
    return path


def _values(value: Any) -> str:
    return ",".join(str(v) for v in value) if isinstance(value, list) else str(value)


def experiment_options(command: F) -> F:
    """Options that make an experiment of a simulation."""
    for option in (
        click.option(
            "--experiment", type=existing, is_eager=True, callback=_read, metavar="FILE",
            help="TOML whose keys are these options, and a table [vary].",
        ),
        click.option(
            "--vary", multiple=True, metavar="NAME=VALUES",
            help="Compare: plugs=2..6, close=ROAD,ROAD, policy=..., or room at a place: dock-1=1..3.",
        ),
        click.option("--runs", default=1, show_default=True, help="Seeds of an experiment, from --seed on."),
    ):  # fmt: skip
        command = option(command)
    return command


def is_experiment(options: dict[str, Any]) -> bool:
    """Whether more than one run is asked for."""
    return bool(options["vary"]) or options["runs"] != 1 or isinstance(options["vehicles"], str)


def seeds(options: dict[str, Any]) -> range:
    """Of the runs."""
    if options["runs"] < 1:
        raise click.UsageError("--runs needs at least one run")
    return range(options["seed"], options["seed"] + options["runs"])


def run_experiment(
    options: dict[str, Any], bases: Sequence[Scenario], progress: Callable[[float, float], None]
) -> Result:
    """The answer; ``bases`` has the scenario of each seed."""
    from fleetlog.simulate.experiment import experiment, factor

    factors, fleet = [factor(text) for text in options["vary"]], options["vehicles"]
    if isinstance(fleet, str) or not factors:
        factors.insert(0, factor(f"vehicles={fleet or bases[0].settings.vehicles}"))
    double = {f.name for f in factors if sum(f.name == g.name for g in factors) > 1}
    if double:
        raise click.UsageError(f"{', '.join(sorted(double))} is varied twice")
    return experiment(bases, factors, progress)
