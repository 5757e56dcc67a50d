"""``fleetlog``: the verbs, loaded when called, and the one place that turns errors into a line and an exit status."""

from __future__ import annotations

import os
import sys
from typing import ClassVar

import click

from fleetlog import __version__
from fleetlog.cli.compiled import find_place
from fleetlog.cli.lazy import LazyGroup
from fleetlog.errors import EXIT_INPUT, EXIT_INTERRUPTED, FleetlogError

# name: (module, one line); the line stands here so that --help imports nothing else.
VERBS: dict[str, tuple[str, str]] = {
    "import": ("import_", "Read logs, match them to the roads, write a dataset and its replay."),
    "simulate": ("simulate", "Generate the trajectories of a fleet on a site."),
    "analyze": ("analyze", "Trips, stops, energy, density, heat maps, chargers."),
    "calibrate": ("calibrate", "Fit a truck to measured runs."),
    "diagnose": ("diagnose", "Say where model and recording differ, and what physics was left out."),
    "export": ("export", "Write a dataset in another format."),
    "info": ("info", "Describe a dataset, log, map or recording."),
    "view": ("view", "Open a replay in the Rerun viewer."),
    "demo": ("demo", "Do the whole job on sample data."),
}


class Verbs(LazyGroup):
    """The verbs of ``fleetlog``."""

    verbs: ClassVar[dict[str, tuple[str, str]]] = {
        name: (f"fleetlog.cli.{module}", line) for name, (module, line) in VERBS.items()
    }


@click.command(cls=Verbs, context_settings={"help_option_names": ["-h", "--help"]}, no_args_is_help=True)
@click.version_option(__version__, "-V", "--version", message="fleetlog %(version)s")
def cli() -> None:
    """Replay, simulate and explain the logs of electric vehicle fleets."""


def entry() -> None:
    """Run the command line and exit with its status."""
    # BLAS threads that spin on a busy machine cost more than they give; must be set before numpy loads.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    own = find_place()
    try:
        status = cli.main(standalone_mode=False)
    except FleetlogError as error:
        click.echo(f"fleetlog: {error.line()}", err=True)
        status = EXIT_INPUT
    except click.exceptions.Abort:
        click.echo("fleetlog: interrupted; nothing was written", err=True)
        status = EXIT_INTERRUPTED
    except click.ClickException as error:
        error.show()
        status = error.exit_code
    except BrokenPipeError:
        sys.stderr.close()
        status = EXIT_INPUT
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        click.echo(f"fleetlog: {where}{' '.join((error.strerror or str(error)).split())}", err=True)
        status = EXIT_INPUT
    except KeyboardInterrupt:
        click.echo("fleetlog: interrupted; nothing was written", err=True)
        status = EXIT_INTERRUPTED
    except MemoryError:
        click.echo("fleetlog: out of memory; take fewer vehicles or days at once", err=True)
        status = EXIT_INPUT
    except Exception as error:
        if os.environ.get("FLEETLOG_DEBUG"):
            raise
        what = " ".join(f"{type(error).__name__}: {error}".split())
        click.echo(
            f"fleetlog: a fault in fleetlog itself, {what}; FLEETLOG_DEBUG=1 shows where, please report it",
            err=True,
        )
        status = EXIT_INPUT
    if status == EXIT_INTERRUPTED:
        # An interrupt inside an import's exec() makes the interpreter die by the signal whatever status is asked for.
        if own is not None:
            import shutil

            shutil.rmtree(own, ignore_errors=True)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status if isinstance(status, int) else 0)
