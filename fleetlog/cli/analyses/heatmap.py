"""``fleetlog analyze heatmap``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleetlog.cli.options import Between, existing
from fleetlog.cli.output import answers

if TYPE_CHECKING:
    from fleetlog.analysis.occupancy.maps import Grouping, Quantity
    from fleetlog.core.result import Result
    from fleetlog.core.site import Site

QUANTITIES = ["occupancy", "passages", "speed", "energy", "standing"]


def _hours(_: click.Context, __: click.Parameter, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    try:
        first, last = (int(part) for part in value.split("-"))
    except ValueError:
        raise click.BadParameter("write it as 6-14") from None
    if not (0 <= first <= 24 and 0 <= last <= 24):
        raise click.BadParameter("hours run from 0 to 24")
    return first, last


@click.command()
@click.argument("dataset", type=existing)
@click.option("--cell", type=Between(0.01, 1e6), default=1.0, show_default=True, help="Size of a cell [m].")
@click.option(
    "--quantity",
    type=click.Choice(QUANTITIES),
    default="occupancy",
    show_default=True,
    help="What is drawn; the tables hold all.",
)
@click.option(
    "--smooth",
    type=Between(0.0, 1e4),
    default=0.0,
    show_default=True,
    help="Standard deviation of a Gaussian blur [m].",
)
@click.option("--hours", callback=_hours, help="Hours of the day, UTC, as 6-14.")
@click.option("--vehicle", "vehicles", multiple=True, help="Only this vehicle; may be given several times.")
@click.option(
    "--load",
    "state",
    type=click.Choice(["all", "laden", "empty"]),
    default="all",
    show_default=True,
    help="Load state.",
)
@click.option("--compare", type=existing, help="Another dataset: draw the difference of time shares.")
@click.option(
    "--by",
    type=click.Choice(["hour", "vehicle", "load"]),
    help="One map for each hour (UTC), vehicle or load state.",
)
@answers
def command(
    dataset: Path, cell: float, quantity: Quantity, smooth: float, hours: tuple[int, int] | None,
    vehicles: tuple[str, ...], state: str, compare: Path | None, by: Grouping | None,
) -> tuple[Result, Site]:  # fmt: skip
    """Draw how much time trucks spend where, on the floor and on the roads."""
    from fleetlog.analysis.heatmap import heatmap
    from fleetlog.store import Dataset

    if by is not None and compare is not None:
        raise click.UsageError("--by and --compare do not go together")
    data = Dataset(dataset)
    other = Dataset(compare) if compare else None
    result = heatmap(
        data,
        cell=cell,
        quantity=quantity,
        smooth=smooth,
        hours=hours,
        vehicles=vehicles,
        state=state,
        compare=other,
        by=by,
    )
    return result, data.site
