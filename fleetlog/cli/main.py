"""``fleetlog``: the verbs; the one place that turns errors into a line and an exit status."""

import gc
import logging
import os
import re
import sys
import warnings
from contextlib import suppress
from io import StringIO, TextIOWrapper

import click

from fleetlog import __version__, interrupt
from fleetlog.cli.commands import Listed, load_verb, notice, verb_lines
from fleetlog.errors import EXIT_INPUT, EXIT_INTERRUPTED, FleetlogError

GARBAGE = 50_000  # Objects between two searches for garbage: loading libraries makes many and no garbage

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
    status = _finished(_status())
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


def _finished(status: int) -> int:
    """The status, after all has been said; an answer that could not be said is an error."""
    try:
        sys.stdout.flush()
    except OSError as error:
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            _complain(f"standard output: {error.strerror}")
        return status or EXIT_INPUT
    return status


def _complain(text: str) -> int:
    """One line, and its status; a scratch file is called by the name that it would have had."""
    notice("fleetlog: " + re.sub(r"\.([^/]+)\.partial/new", r"\1", text))
    return EXIT_INPUT


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
        return EXIT_INPUT if isinstance(error, BrokenPipeError) else _complain(_line(error))
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
