"""``fleetlog analyze stops``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fleetlog.cli.options import answer_options, existing


@click.command()
@click.argument("dataset", type=existing)
@click.option("--min-visits", default=3, show_default=True, help="A place was visited at least so often.")
@answer_options
def command(dataset: Path, min_visits: int, **told: Any) -> None:
    """Find the places where trucks stand again and again, and what for."""
    from fleetlog.analysis.stops import stops
    from fleetlog.cli.output import answer
    from fleetlog.store import Dataset

    source = Dataset(dataset)
    answer(stops(source, min_visits=min_visits), source.site, **told)
