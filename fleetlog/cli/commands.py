"""Commands read from the functions of the library: their options are its arguments; how answers are told."""

from __future__ import annotations

import functools
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

import fleetlog
from fleetlog import VERBS
from fleetlog.api.verb import REQUIRED, Option, Verb, description
from fleetlog.errors import ArgumentError, nearest
from fleetlog.listening import Progress, listening, unheard
from fleetlog.registry import part_lines

if TYPE_CHECKING:
    from fleetlog.api.answer import Answer

TELLING = (
    click.Option(["--json", "as_json"], is_flag=True, help="Print the summary as one JSON object."),
    click.Option(["-q", "--quiet"], is_flag=True, help="Print nothing but errors."),
    click.Option(["-v", "--verbose"], is_flag=True, help="Print every step with its time."),
)
OPTIONAL_OUTPUT = {"import", "demo", "view", "info"}
"""Commands that write nothing, or only when asked to; the others must be told where."""

# Help breaks between words only, not at the hyphens of options and names.
textwrap.TextWrapper.wordsep_re = textwrap.TextWrapper.wordsep_simple_re
TABLE_GAP = "  "  # Two blanks within a line: columns, which are not wrapped


class Listed(click.Group):
    """A group whose commands are imported only when called; ``lines`` has each with its line of help."""

    def __init__(
        self, lines: Callable[[], dict[str, str]], load: Callable[[str], click.Command], **more: Any
    ) -> None:
        super().__init__(no_args_is_help=True, **more)
        self.lines, self.load = lines, load

    def list_commands(self, ctx: click.Context) -> list[str]:
        """In the order of a first visit, not of the alphabet."""
        return list(self.lines())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command; the nearest one is suggested for another word."""
        if cmd_name in self.lines():
            return self.load(cmd_name)
        if cmd_name.startswith("-") or ctx.resilient_parsing:
            return None
        raise click.UsageError(f"No such command {cmd_name!r}; {nearest(cmd_name, self.lines())}", ctx)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self.lines().items()))


def verb_lines() -> dict[str, str]:
    """Every verb with its line of help, in the order of a first visit."""
    return {n.rstrip("_"): part_lines("fleetlog.verbs", "")[n] for n in VERBS}


def load_verb(name: str) -> click.Command:
    """The command ``name``."""
    found = getattr(fleetlog, "import_" if name == "import" else name)
    if isinstance(found, Verb):
        return command_of(found)
    return Listed(found.lines, lambda n: command_of(found.named(n)), name=name, help=verb_lines()[name])


def command_of(verb: Verb) -> click.Command:
    """The command of a function."""
    params = [*(_parameter(o, verb) for o in verb.options), *TELLING]
    text = description(verb.function.__doc__)
    return click.Command(verb.name, params=params, help=text, callback=functools.partial(_run, verb))


def _parameter(option: Option, verb: Verb) -> click.Parameter:
    # What a file may fill in is asked for once the file is read.
    required = option.default is REQUIRED and (verb.fill is None or option.positional)
    required = required or (option.name == "output" and verb.name not in OPTIONAL_OUTPUT)
    of_file = click.Path(readable=False) if option.is_path else None  # for the shell, which completes it
    kind = click.Choice(option.choices) if option.choices else of_file
    more: dict[str, Any] = {"type": kind, "required": required}
    if option.positional:
        return click.Argument([option.name], nargs=-1 if option.many else 1, **more)
    names = [option.name, option.spelling, *(["-o"] if option.name == "output" else [])]
    text = option.help
    if option.flag:
        text = f"Do not {text[:1].lower()}{text[1:]}" if option.default is True else text
        return click.Option(names, is_flag=True, help=text)
    more["metavar"] = None if option.choices else getattr(option.check, "metavar", "TEXT").upper()
    if not required:  # None, given as a default, is a value to some releases of click
        listed = isinstance(option.default, tuple)
        default = (",".join(map(str, option.default)) or None) if listed else option.default
        more["default"] = None if default is REQUIRED else default
    return click.Option(names, help=text, multiple=option.many, show_default=True, **more)


def _run(verb: Verb, as_json: bool, quiet: bool, verbose: bool, **values: Any) -> int:
    """Call the function with what was given, tell its answer; return the exit status."""
    context = click.get_current_context()
    left = (ParameterSource.DEFAULT, None)
    given = {n: v for n, v in values.items() if context.get_parameter_source(n) not in left}
    defaults = {o.name: o.default for o in verb.options}
    given = {n: not v if defaults[n] is True else v for n, v in given.items()}
    if verb.name == "import" and not {"output", "dry_run"} & given.keys():
        raise click.UsageError("say where the dataset goes with -o, or look first with --dry-run", context)
    try:
        return tell(verb, given, as_json=as_json, quiet=quiet, verbose=verbose)
    except ArgumentError as error:
        raise click.UsageError(error.line(), context) from None


def tell(verb: Verb, given: dict[str, Any], *, as_json: bool, quiet: bool, verbose: bool) -> int:
    """Call ``verb`` with ``given``, print its answer, return the exit status."""
    how: AbstractContextManager[Progress] = nullcontext(_steps() if verbose else unheard)
    if not (verbose or quiet) and sys.stderr.isatty():
        how = _bar(verb.name)
    with how as progress, listening(progress, unheard if quiet and not verbose else notice):
        answer: Answer = verb(**given)
    try:
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
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from None
    return answer.status


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
