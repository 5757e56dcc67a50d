"""``fleetlog analyze energy``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleetlog.cli.options import anywhere, existing
from fleetlog.cli.output import answers

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.core.site import Site


def _hours(_: click.Context, __: click.Parameter, value: str) -> tuple[int, ...]:
    try:
        hours = tuple(sorted({int(part) for part in value.split(",")}))
    except ValueError:
        raise click.BadParameter("write it as 6,14,22") from None
    if not hours or not all(0 <= h < 24 for h in hours):
        raise click.BadParameter("hours run from 0 to 23")
    return hours


@click.command()
@click.argument("dataset", type=existing)
@click.option("--truck", required=True, help="Truck file, or name of a preset.")
@click.option("--physics", type=anywhere, help="Physics that diagnose found (model.toml or its folder).")
@click.option(
    "--shifts",
    default="6,14,22",
    show_default=True,
    callback=_hours,
    help="Hours at which shifts begin, UTC.",
)
@click.option(
    "--battery",
    "chemistry",
    type=click.Choice(["constant", "lfp", "lead"]),
    default="constant",
    show_default=True,
    help="Shape of the battery's voltage over its charge.",
)
@answers
def command(
    dataset: Path, truck: str, physics: Path | None, shifts: tuple[int, ...], chemistry: str
) -> tuple[Result, Site]:
    """Say what every trip costs, by physical cause, beside what was measured."""
    from fleetlog.analysis.energy import energy
    from fleetlog.core.truck import load_truck
    from fleetlog.physics.model import load_physics
    from fleetlog.store.dataset import Dataset

    data, model = Dataset(dataset), load_truck(truck)
    known = None if physics is None else load_physics(physics, model, data.site.network)
    return energy(data, model, known, shifts=shifts, chemistry=chemistry), data.site
