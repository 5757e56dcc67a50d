"""``fleetlog analyze chargers``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fleetlog.cli.options import SEED, VEHICLES, Between, existing
from fleetlog.cli.output import answers
from fleetlog.cli.simulate import Duration

if TYPE_CHECKING:
    from fleetlog.core.result import Result
    from fleetlog.core.site import Site


@click.command()
@click.argument("dataset", type=existing)
@click.option(
    "-k", default=5, show_default=True, type=click.IntRange(1, 10_000), help="At most so many sites."
)
@click.option(
    "--method",
    type=click.Choice(["pmedian", "spaced", "topk", "cover"]),
    default="pmedian",
    show_default=True,
    help="How sites are chosen.",
)
@click.option(
    "--variant",
    type=click.Choice(["flow", "vote", "urgency"]),
    default="flow",
    show_default=True,
    help="How vertices are ranked.",
)
@click.option(
    "--demand",
    type=click.Choice(["urgency", "standing", "visits", "rank", "loading"]),
    default="urgency",
    show_default=True,
    help="What a vertex weighs; loading places pick and drop spots instead of chargers.",
)
@click.option(
    "--metric",
    type=click.Choice(["distance", "time", "energy"]),
    default="distance",
    show_default=True,
    help="What is kept small; energy is that of the empty truck and needs --truck.",
)
@click.option(
    "--shortest",
    type=Between(0.0, 1e6),
    default=60.0,
    show_default=True,
    help="Least standstill in which plugging in is worth it [s].",
)
@click.option(
    "--spacing",
    type=Between(0.0, 1e6),
    default=30.0,
    show_default=True,
    help="Least distance between sites, for --method spaced [m].",
)
@click.option(
    "--radius",
    type=Between(0.0, 1e6),
    default=30.0,
    show_default=True,
    help="Reach of a site, for --method cover [m].",
)
@click.option(
    "--alpha",
    default=0.85,
    show_default=True,
    type=Between(0, 1, max_open=True),
    help="Damping of the rank.",
)
@click.option(
    "--force", "forced", multiple=True, help="A vertex or place that must be a site (an existing charger)."
)
@click.option("--forbid", "forbidden", multiple=True, help="A vertex or place that must not be one.")
@click.option("--keep-existing", is_flag=True, help="Keep the site's own chargers; they count among the k.")
@click.option(
    "--capacity",
    type=Between(0, 1, min_open=True),
    help="Largest share of the demand that one site may serve.",
)
@click.option("--truck", type=str, help="Truck file, or name of a preset; for --metric energy and --check.")
@click.option(
    "--check", is_flag=True, help="Try the plan in the simulator: the same tasks, before and after."
)
@click.option("--vehicles", type=VEHICLES, help="Trucks in the simulator; by default as many as recorded.")
@click.option(
    "--duration", type=Duration(), default="8h", show_default=True, help="Of the simulation: 8h, 90m."
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of the simulation.")
@click.option("--soc", default=0.6, show_default=True, type=Between(0.05, 1.0), help="Charge at its start.")
@answers
def command(
    dataset: Path, truck: str | None, check: bool, vehicles: int | None, duration: float, seed: int,
    soc: float, **options: Any,
) -> tuple[Result, Site]:  # fmt: skip
    """Choose where chargers belong, and say how good the choice is."""
    from fleetlog.analysis.chargers import chargers
    from fleetlog.analysis.placement.check import Trial
    from fleetlog.core.truck import load_truck
    from fleetlog.store import Dataset

    if truck is None and (check or options["metric"] == "energy"):
        raise click.UsageError("--check and --metric energy need a truck: name one with --truck")
    data = Dataset(dataset)
    model = load_truck(truck) if truck is not None else None
    trial = (
        Trial(model, vehicles or len(data.vehicles), duration, seed, soc)
        if check and model is not None
        else None
    )
    return chargers(data, truck=model, trial=trial, **options), data.site
