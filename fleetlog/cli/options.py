"""Options that several verbs share, and how a summary is said."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

json_option = click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an older output.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")
existing = click.Path(exists=True, path_type=Path)
anywhere = click.Path(path_type=Path)


def output_option(what: str) -> Callable[[F], F]:
    """``-o``, required."""
    return click.option("-o", "--output", type=anywhere, required=True, help=what)


def answer_options(command: F) -> F:
    """Where the answer to a question goes and how it is said; :func:`fleetlog.cli.output.answer` takes their values."""
    for option in (quiet_option, overwrite_option, json_option, output_option("Folder for the answer.")):
        command = option(command)
    return command


def notice(text: str, quiet: bool = False) -> None:
    """A line for a person, on standard error."""
    if not quiet:
        click.echo(text, err=True)


def say(lines: Iterable[str], summary: dict[str, Any], *, as_json: bool, quiet: bool = False) -> None:
    """The answer on standard output: the lines, or with ``--json`` the summary as one object."""
    from fleetlog.store.results import plain

    if as_json:
        click.echo(json.dumps(plain(summary), allow_nan=False))
    elif not quiet:
        for line in lines:
            click.echo(line)
