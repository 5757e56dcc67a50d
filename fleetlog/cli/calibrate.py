"""``fleetlog calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

from fleetlog.cli.options import (
    anywhere,
    existing,
    json_option,
    named_files,
    output_option,
    overwrite_option,
    quiet_option,
    say,
)


@click.command()
@click.argument("measurements", nargs=-1, required=True, type=existing)
@click.option("--truck", required=True, help="Truck file, or name of a preset, to start from.")
@click.option("--physics", type=anywhere, help="Model with terms known beforehand (model.toml).")
@output_option("Truck file to write.")
@overwrite_option
@json_option
@quiet_option
def command(
    measurements: tuple[Path, ...], truck: str, physics: Path | None, output: Path, overwrite: bool,
    as_json: bool, quiet: bool,
) -> None:  # fmt: skip
    """Fit a truck to MEASUREMENTS: tables of measured runs (CSV) or recorded datasets with power.

    Numbers that the runs cannot tell stay as they were, and what to measure for them is said.
    """
    from fleetlog.calibrate.calibrate import calibrate
    from fleetlog.calibrate.report import lines, summary, truck_toml
    from fleetlog.core.truck import load_truck
    from fleetlog.physics.model import load_physics
    from fleetlog.store.output import atomic_output

    inputs = named_files(dict(measurements=measurements, truck=truck, physics=physics))
    with atomic_output(
        output, "calibrated truck", overwrite=overwrite, folder=False, inputs=inputs
    ) as scratch:
        nominal = load_truck(truck)
        known = None if physics is None else load_physics(physics, nominal)
        fit = calibrate(measurements, nominal, known)
        scratch.write_text(truck_toml(fit), encoding="utf-8")
    say(lines(fit), summary(fit), as_json=as_json, quiet=quiet)
