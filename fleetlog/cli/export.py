"""``fleetlog export``: a dataset in another format."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import existing, json_option, output_option, overwrite_option, quiet_option, say
from fleetlog.errors import nearest

FORMATS = (
    "csv", "geojson", "gpx", "kitti", "mcap", "moving-features", "parquet", "sumo-fcd", "sumo-net", "tum",
    "vda5050",
)  # fmt: skip


@click.command("export")
@click.argument("dataset", type=existing)
@click.option("--to", "to", required=True, metavar="FORMAT", help=f"One of {', '.join(FORMATS)}.")
@output_option("File to write.")
@click.option("--vehicle", "vehicles", multiple=True, help="Only this vehicle; may be given several times.")
@overwrite_option
@json_option
@quiet_option
def command(
    dataset: Path,
    to: str,
    output: Path,
    vehicles: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write DATASET in another format: tables, tracks, recordings, SUMO."""
    from fleetlog.exporters.base import export_dataset, exporters

    if to not in exporters():
        raise click.UsageError(f"no export format {to!r}; {nearest(to, exporters())}")
    summary = export_dataset(dataset, to, output, vehicles=vehicles, overwrite=overwrite)
    left_out = summary.get("rows_without_position")
    what = "edges" if "edges" in summary else "rows"
    lines = [
        f"{summary['rows']:,} {what} of {dataset} written to {output} ({to}, {summary['bytes']:,} bytes)"
    ]
    if left_out:
        lines.append(f"{left_out:,} rows have no position and were left out")
    say(lines, summary, as_json=as_json, quiet=quiet)
