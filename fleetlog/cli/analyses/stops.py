"""``fleetlog analyze stops``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleetlog.cli.options import existing
from fleetlog.cli.output import answers

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.core.site import Site


@click.command()
@click.argument("dataset", type=existing)
@click.option(
    "--min-visits",
    type=click.IntRange(1),
    default=3,
    show_default=True,
    help="A place was visited at least so often.",
)
@answers
def command(dataset: Path, min_visits: int) -> tuple[Result, Site]:
    """Find the places where trucks stand again and again, and what for."""
    from fleetlog.analysis.stops import stops
    from fleetlog.store import Dataset

    source = Dataset(dataset)
    return stops(source, min_visits=min_visits), source.site
