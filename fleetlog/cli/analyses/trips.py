"""``fleetlog analyze trips``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fleetlog.cli.options import answer_options, existing


@click.command()
@click.argument("dataset", type=existing)
@click.option("--min-distance", default=5.0, show_default=True, help="Shorter trips are shunting [m].")
@answer_options
def command(dataset: Path, min_distance: float, **told: Any) -> None:
    """Say where trucks drive from and to, how far, how long, at what cost."""
    from fleetlog.analysis.trips import trips
    from fleetlog.cli.output import answer
    from fleetlog.store import Dataset

    source = Dataset(dataset)
    answer(trips(source, min_distance=min_distance), source.site, **told)
