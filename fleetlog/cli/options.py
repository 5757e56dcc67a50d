"""Options that several verbs share, and how a summary is said."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import click

F = TypeVar("F", bound=Callable[..., Any])


class Between(click.FloatRange):
    """A finite number between two bounds: ``nan`` lies between any two for click, ``inf`` above any."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or wrong usage."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


SEED = click.IntRange(0, 2**63 - 1)
VEHICLES = click.IntRange(1, 100_000)

json_option = click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an older output.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")


class Where(click.Path):
    """A file or a folder, or a dataset behind a URL (``s3://...``)."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path, or an object that is used like one."""
        if "://" not in str(value):
            return super().convert(value, param, ctx)
        from fleetlog.store.places import located

        return located(value)


existing = Where(exists=True, path_type=Path)
anywhere = Where(path_type=Path)


def output_option(what: str) -> Callable[[F], F]:
    """``-o``, required."""
    return click.option("-o", "--output", type=anywhere, required=True, help=what)


def answer_options(command: F) -> F:
    """Where an answer goes and how it is said; :func:`fleetlog.cli.output.answers` takes their values."""
    for option in (quiet_option, overwrite_option, json_option, output_option("Folder for the answer.")):
        command = option(command)
    return command


def engine_options(command: F) -> F:
    """``--workers`` and ``--scheduler``: where the jobs of a command run."""

    @functools.wraps(command)
    def run(*given: Any, workers: int | None, scheduler: str | None, **options: Any) -> Any:
        from fleetlog.engines import using

        if workers is not None and scheduler is not None:
            raise click.UsageError("--workers and --scheduler do not go together")
        with using(workers, scheduler):
            return command(*given, **options)

    for option in (
        click.option("--scheduler", metavar="ADDRESS", help="Dask cluster to run on: tcp://HOST:PORT."),
        click.option(
            "--workers",
            type=click.IntRange(1, 1024),
            help="Processes; by default as many as there are cores.",
        ),
    ):
        run = option(run)
    return cast(F, run)


def printable(text: str) -> str:
    """``text`` with control and formatting characters and line ends as escapes: no terminal obeys it."""
    return "".join(c if c.isprintable() or c in "\N{NO-BREAK SPACE}" else ascii(c)[1:-1] for c in text)


def named_files(options: dict[str, Any]) -> list[Path]:
    """The files and folders that a command line reads:
    every path but the output, the truck where it is one.
    """
    values = [v for value in options.values() for v in (value if isinstance(value, tuple) else (value,))]
    truck = options.get("truck")
    return [v for v in [*values, truck and Path(truck)] if isinstance(v, Path)]


def notice(text: str, quiet: bool = False) -> None:
    """A line for a person, on standard error; nobody there to read it is no fault."""
    if not quiet:
        with suppress(OSError):
            click.echo(printable(text), err=True)


def say(lines: Iterable[str], summary: dict[str, Any], *, as_json: bool, quiet: bool = False) -> None:
    """The answer on standard output: the lines, or with ``--json`` the summary as one object."""
    from fleetlog.store.documents import json_text

    if as_json:
        click.echo(json_text(summary))
    elif not quiet:
        for line in lines:
            click.echo(printable(line))
