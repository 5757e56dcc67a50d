"""``fleetlog``: commands read from the functions of the library, whose arguments are their options; how
answers are told; the one place that turns errors into a line and an exit status."""

import functools
import gc
import logging
import os
import re
import shutil
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from io import StringIO, TextIOWrapper
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

import fleetlog
from fleetlog import VERBS, __version__, interrupt
from fleetlog.api.verb import REQUIRED, Option, Verb, description
from fleetlog.errors import EXIT_INPUT, EXIT_INTERRUPTED, ArgumentError, FleetlogError, nearest
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
GARBAGE = 50_000  # Objects between two searches for garbage: loading libraries makes many and no garbage

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
    how: AbstractContextManager[Progress] = nullcontext(_steps() if verbose else unheard)
    if not (verbose or quiet) and sys.stderr.isatty():
        how = _bar(verb.name)
    try:
        with how as progress, listening(progress, unheard if quiet and not verbose else notice):
            answer: Answer = verb(**given)
    except ArgumentError as error:
        raise click.UsageError(error.line(), context) from None
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


cli = Listed(
    verb_lines, load_verb, name="fleetlog",
    help="Replay, simulate and explain the logs of electric vehicle fleets.",
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip
cli = click.version_option(__version__, "-V", "--version", message="fleetlog %(version)s")(cli)


def entry() -> None:
    """Run the command line and exit with its status."""
    # BLAS threads that spin on a busy machine cost more than they give; must be set before numpy loads.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    gc.set_threshold(GARBAGE)
    _open_streams()
    interrupt.install()
    if not os.environ.get("FLEETLOG_DEBUG"):  # warnings of libraries name source files
        os.environ.setdefault("RUST_LOG", "off")
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
    status = _status()
    try:
        sys.stdout.flush()
    except OSError as error:  # an answer that could not be said is an error
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            notice(f"fleetlog: standard output: {error.strerror}")
        status = status or EXIT_INPUT
    interrupt.ignore()
    if status == EXIT_INTERRUPTED:
        # An interrupt inside an import's exec() makes the interpreter die by the signal, whatever the status.
        from fleetlog import scratch

        scratch.clear()
        os._exit(status)
    sys.exit(status)


def _open_streams() -> None:
    """Give closed standard streams a place: the next file to be opened would take their number and texts."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _status() -> int:
    """Run the command line; every error becomes one line and a status."""
    try:
        status = cli.main(standalone_mode=False)
    except click.ClickException as error:
        usage = StringIO()
        error.show(usage)
        for line in usage.getvalue().splitlines():
            notice(line)
        return error.exit_code
    except (Exception, KeyboardInterrupt) as error:
        # A library that was torn out of its loading by an interrupt fails in its own way.
        if interrupt.came() or isinstance(error, click.exceptions.Abort | KeyboardInterrupt):
            notice(interrupt.TOLD)
            return EXIT_INTERRUPTED
        if os.environ.get("FLEETLOG_DEBUG") and not isinstance(error, FleetlogError | OSError | MemoryError):
            raise
        if not isinstance(error, BrokenPipeError):
            # A scratch file is called by the name that it would have had.
            notice("fleetlog: " + re.sub(r"\.([^/]+)\.partial/new", r"\1", _line(error)))
        return EXIT_INPUT
    return status if isinstance(status, int) else 0


def _line(error: BaseException) -> str:
    """What went wrong, for the user."""
    if isinstance(error, FleetlogError):
        return error.line()
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return where + " ".join((error.strerror or str(error)).split())
    if isinstance(error, MemoryError):
        return "out of memory; take fewer vehicles or days at once"
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return f"a fault in fleetlog itself, {what}; FLEETLOG_DEBUG=1 shows where, please report it"
