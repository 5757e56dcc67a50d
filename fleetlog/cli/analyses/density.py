"""``fleetlog analyze density``."""

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
    "--threshold",
    type=Between(0.01, 1e6),
    default=15.0,
    show_default=True,
    help="Driving distance within which trucks belong together [m].",
)
@click.option(
    "--speed",
    type=Between(0.01, 100.0),
    default=1.4,
    show_default=True,
    help="A cluster is critical when its mean speed is under this [m/s].",
)
@click.option("--step", type=Between(0.01, 3600.0), default=1.0, show_default=True, help="Time step [s].")
@click.option(
    "--min-duration",
    type=Between(0.0, 1e6),
    default=5.0,
    show_default=True,
    help="Ignore shorter episodes [s].",
)
@click.option("--include-standing", is_flag=True, help="Count parked, charging and handling trucks too.")
@answers
def command(
    dataset: Path, threshold: float, speed: float, step: float, min_duration: float, include_standing: bool
) -> tuple[Result, Site]:
    """Find where trucks crowd: clusters along the roads, episodes, critical areas."""
    from fleetlog.analysis.density import density
    from fleetlog.store import Dataset

    data = Dataset(dataset)
    result = density(
        data,
        threshold=threshold,
        speed=speed,
        step=step,
        min_duration=min_duration,
        include_standing=include_standing,
    )
    return result, data.site
