"""Commands read from the functions of the library: their options are its arguments.

A command adds only how its answer is told: ``--json``, ``-q``, ``-v``.
"""

import functools
import textwrap
from collections.abc import Callable
from typing import Any

import click
from click.core import ParameterSource

import fleetlog
from fleetlog import VERBS
from fleetlog.api.verb import REQUIRED, Option, Verb, description
from fleetlog.cli.tell import tell
from fleetlog.errors import ArgumentError, nearest
from fleetlog.registry import part_lines

TELLING = (
    click.Option(["--json", "as_json"], is_flag=True, help="Print the summary as one JSON object."),
    click.Option(["-q", "--quiet"], is_flag=True, help="Print nothing but errors."),
    click.Option(["-v", "--verbose"], is_flag=True, help="Tell every step, with its time."),
)
OPTIONAL_OUTPUT = {"import", "demo", "view", "info"}
"""Commands that write nothing, or only when asked to; the others must be told where."""


# Help breaks between words only, not at the hyphens of options and names.
textwrap.TextWrapper.wordsep_re = textwrap.TextWrapper.wordsep_simple_re


class Listed(click.Group):
    """A group whose commands are imported only when called; ``lines`` has each with its line of help."""

    def __init__(
        self, lines: Callable[[], dict[str, str]], load: Callable[[str], click.Command], **more: Any
    ) -> None:
        super().__init__(**more)
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
    found = part_lines("fleetlog.verbs", "")
    return {n.rstrip("_"): found[n] for n in VERBS}


def load_verb(name: str) -> click.Command:
    """The command ``name``."""
    found = getattr(fleetlog, "import_" if name == "import" else name)
    if isinstance(found, Verb):
        return command_of(found)
    return Listed(
        found.lines, lambda n: command_of(found.named(n)), name=name, help=verb_lines()[name],
        no_args_is_help=True,
    )  # fmt: skip


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
