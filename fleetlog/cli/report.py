"""``fleetlog report``."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import (
    anywhere,
    existing,
    json_option,
    named_files,
    notice,
    output_option,
    overwrite_option,
    quiet_option,
    say,
)


@click.command()
@click.argument("datasets", type=anywhere, nargs=-1, required=True)
@click.option(
    "--truck", help="Truck file, or name of a preset: energy by cause, and what the model leaves out."
)
@click.option("--tariff", type=existing, help="Prices and CO2 of energy by hour (TOML).")
@click.option("--timezone", help="Time zone of the hours, as Europe/Berlin; that of the site by default.")
@click.option(
    "--diagnosis/--no-diagnosis", default=True, show_default=True, help="Run diagnose where a truck is given."
)
@click.option(
    "--tables", type=anywhere, help="Write the tables too: a folder of Parquet files, or NAME.xlsx."
)
@output_option("HTML page to write.")
@overwrite_option
@json_option
@quiet_option
def command(
    datasets: tuple[Path, ...], truck: str | None, tariff: Path | None, timezone: str | None, diagnosis: bool,
    tables: Path | None, output: Path, overwrite: bool, as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Write one page about the fleet of a dataset, or about two datasets side by side.

    The page is one file: it needs no network, prints, and reads on a phone.  Of two datasets it gives the
    differences of the second from the first, and whether they are larger than chance.
    """
    from fleetlog.report import report
    from fleetlog.report.output import written

    if len(datasets) > 2:
        raise click.UsageError(f"a report takes one or two datasets, not {len(datasets)}")
    inputs = named_files(dict(datasets=datasets, truck=truck, tariff=tariff))
    with written(output, tables, overwrite=overwrite, inputs=inputs) as write:
        found = report(
            *datasets, truck=truck, tariff=tariff, timezone=timezone, diagnosis=diagnosis,
            progress=lambda step: notice(f"  {step}", quiet),
        )  # fmt: skip
        write(found)
    said = [*found.lines, f"report: {output}", *([f"tables: {tables}"] if tables else [])]
    say(said, {**found.summary, "output": str(output)}, as_json=as_json, quiet=quiet)
