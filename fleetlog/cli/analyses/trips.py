"""``fleetlog analyze trips``."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import existing, json_option, output_option, overwrite_option, quiet_option, say


@click.command()
@click.argument("dataset", type=existing)
@click.option("--min-distance", default=5.0, show_default=True, help="Shorter trips are shunting [m].")
@output_option("Folder for the answer.")
@json_option
@overwrite_option
@quiet_option
def command(
    dataset: Path, min_distance: float, output: Path, as_json: bool, overwrite: bool, quiet: bool
) -> None:
    """Say where trucks drive from and to, how far, how long, at what cost."""
    from fleetlog.analysis.trips import trips
    from fleetlog.cli.output import write_analysis
    from fleetlog.store import Dataset

    source = Dataset(dataset)
    result = trips(source, min_distance=min_distance)
    write_analysis(result, source.site, output, overwrite)
    say(result.lines, result.summary, as_json=as_json, quiet=quiet)
