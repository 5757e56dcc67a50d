"""``fleetlog analyze trips``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleetlog.cli.options import Between, existing
from fleetlog.cli.output import answers

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.core.site import Site


@click.command()
@click.argument("dataset", type=existing)
@click.option(
    "--min-distance",
    type=Between(0.0, 1e6),
    default=5.0,
    show_default=True,
    help="Shorter trips are shunting [m].",
)
@answers
def command(dataset: Path, min_distance: float) -> tuple[Result, Site]:
    """Say where trucks drive from and to, how far, how long, at what cost."""
    from fleetlog.analysis.trips import trips
    from fleetlog.store import Dataset

    source = Dataset(dataset)
    return trips(source, min_distance=min_distance), source.site
