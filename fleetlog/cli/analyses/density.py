"""``fleetlog analyze density``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fleetlog.cli.options import answer_options, existing


@click.command()
@click.argument("dataset", type=existing)
@click.option(
    "--threshold",
    default=15.0,
    show_default=True,
    help="Driving distance within which trucks belong together [m].",
)
@click.option(
    "--speed",
    default=1.4,
    show_default=True,
    help="A cluster is critical when its mean speed is under this [m/s].",
)
@click.option("--step", default=1.0, show_default=True, help="Time step [s].")
@click.option("--min-duration", default=5.0, show_default=True, help="Pass over shorter episodes [s].")
@click.option("--include-standing", is_flag=True, help="Count parked, charging and handling trucks too.")
@answer_options
def command(
    dataset: Path, threshold: float, speed: float, step: float, min_duration: float, include_standing: bool, **told: Any
) -> None:  # fmt: skip
    """Find where trucks crowd: clusters along the roads, episodes, critical areas."""
    from fleetlog.analysis.density import density
    from fleetlog.cli.output import answer
    from fleetlog.store import Dataset

    if min(threshold, speed, step) <= 0:
        raise click.UsageError("--threshold, --speed and --step must be positive")
    data = Dataset(dataset)
    result = density(
        data,
        threshold=threshold,
        speed=speed,
        step=step,
        min_duration=min_duration,
        include_standing=include_standing,
    )
    answer(result, data.site, **told)
