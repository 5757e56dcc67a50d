"""``fleetlog analyze chargers``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fleetlog.cli.options import existing, json_option, output_option, overwrite_option, quiet_option, say


@click.command()
@click.argument("dataset", type=existing)
@click.option("-k", default=5, show_default=True, type=click.IntRange(1), help="At most so many sites.")
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
    "--demand", type=click.Choice(["urgency", "standing", "visits", "rank", "loading"]), default="urgency", show_default=True,
    help="What a vertex weighs; loading places pick and drop spots instead of chargers.",
)  # fmt: skip
@click.option(
    "--metric",
    type=click.Choice(["distance", "time"]),
    default="distance",
    show_default=True,
    help="What is kept short.",
)
@click.option(
    "--shortest",
    default=60.0,
    show_default=True,
    help="Least standstill in which plugging in is worth it [s].",
)
@click.option(
    "--spacing",
    default=30.0,
    show_default=True,
    help="Least distance between sites, for --method spaced [m].",
)
@click.option("--radius", default=30.0, show_default=True, help="Reach of a site, for --method cover [m].")
@click.option(
    "--alpha",
    default=0.85,
    show_default=True,
    type=click.FloatRange(0, 1, max_open=True),
    help="Damping of the rank.",
)
@click.option(
    "--force", "forced", multiple=True, help="A vertex or place that must be a site (an existing charger)."
)
@click.option("--forbid", "forbidden", multiple=True, help="A vertex or place that must not be one.")
@output_option("Folder for the answer.")
@json_option
@overwrite_option
@quiet_option
def command(dataset: Path, output: Path, as_json: bool, overwrite: bool, quiet: bool, **options: Any) -> None:
    """Choose where chargers belong, and say how good the choice is."""
    from fleetlog.analysis.chargers import chargers
    from fleetlog.cli.output import write_analysis
    from fleetlog.store import Dataset

    data = Dataset(dataset)
    result = chargers(data, **options)
    write_analysis(result, data.site, output, overwrite)
    say(result.lines, result.summary, as_json=as_json, quiet=quiet)
