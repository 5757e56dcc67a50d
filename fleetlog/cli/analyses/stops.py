"""``fleetlog analyze stops``."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import existing, json_option, output_option, overwrite_option, quiet_option, say


@click.command()
@click.argument("dataset", type=existing)
@click.option("--min-visits", default=3, show_default=True, help="A place was visited at least so often.")
@output_option("Folder for the answer.")
@json_option
@overwrite_option
@quiet_option
def command(
    dataset: Path, min_visits: int, output: Path, as_json: bool, overwrite: bool, quiet: bool
) -> None:
    """Find the places where trucks stand again and again, and what for."""
    from fleetlog.analysis.stops import stops
    from fleetlog.cli.output import write_analysis
    from fleetlog.store import Dataset

    source = Dataset(dataset)
    result = stops(source, min_visits=min_visits)
    write_analysis(result, source.site, output, overwrite)
    say(result.lines, result.summary, as_json=as_json, quiet=quiet)
