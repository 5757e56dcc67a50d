"""How an answer is told: on a terminal, to a script, quietly; and how far a run is."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any

import click

from fleetlog.listening import Progress, listening, unheard

if TYPE_CHECKING:
    from fleetlog.api.answer import Answer
    from fleetlog.api.verb import Verb

TABLE_GAP = "  "  # Two blanks within a line: columns, which are not wrapped


def tell(verb: Verb, given: dict[str, Any], *, as_json: bool, quiet: bool, verbose: bool) -> int:
    """Call ``verb`` with ``given``, print its answer, return the exit status."""
    how: AbstractContextManager[Progress] = nullcontext(_steps() if verbose else unheard)
    if not (verbose or quiet) and sys.stderr.isatty():
        how = _bar(verb.name)
    with how as progress, listening(progress, unheard if quiet and not verbose else notice):
        answer: Answer = verb(**given)
    try:
        _print(answer, as_json, quiet)
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from None
    return answer.status


def _print(answer: Answer, as_json: bool, quiet: bool) -> None:
    if as_json:
        from fleetlog.store.documents import json_text

        where = {} if answer.output is None else {"output": str(answer.output)}
        click.echo(json_text({**answer.summary, **where}))
    elif quiet and answer.warning:
        notice(f"fleetlog: {answer.warning}")
    elif not quiet:
        for line in answer.lines:
            click.echo(wrapped(printable(line)))
        if answer.output is not None:
            click.echo(printable(f"{answer.kind}: {answer.output}"))


def printable(text: str) -> str:
    """``text`` with control and formatting characters and line ends as escapes: no terminal obeys it."""
    return "".join(c if c.isprintable() or c in "\N{NO-BREAK SPACE}" else ascii(c)[1:-1] for c in text)


def wrapped(line: str) -> str:
    """A sentence broken between words at the width of the terminal; as it is for a file, and in columns."""
    width = shutil.get_terminal_size().columns
    if len(line) <= width or not sys.stdout.isatty() or TABLE_GAP in line.strip():
        return line
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.fill(
        line.strip(), width, initial_indent=indent, subsequent_indent=f"{indent}  ", break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def notice(text: str) -> None:
    """A line for a person, on standard error; nobody there to read it is no fault."""
    with suppress(OSError):
        click.echo(printable(text), err=True)


def _steps() -> Progress:
    begun, last = time.monotonic(), [""]

    def step(text: str, share: float) -> None:
        if text != last[0]:
            last[0] = text
            notice(f"{time.monotonic() - begun:7.1f} s  {text}")

    return step


@contextmanager
def _bar(name: str) -> Iterator[Progress]:
    """A bar that ends with a line, once a run has lasted a second."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress as Bar

    begun = time.monotonic()
    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=1.0)
        yield lambda text, share: bar.update(task, description=escape(printable(text)), completed=share)
    if (took := time.monotonic() - begun) > 1.0:
        notice(f"{name}: done in {took:.0f} s")
