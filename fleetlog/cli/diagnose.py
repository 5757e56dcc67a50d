"""``fleetlog diagnose``."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fleetlog.cli.options import (
    SEED,
    anywhere,
    engine_options,
    existing,
    json_option,
    named_files,
    notice,
    output_option,
    overwrite_option,
    quiet_option,
    say,
)
from fleetlog.errors import nearest

if TYPE_CHECKING:
    from fleetlog.discovery.report.finding import Verdict

CHANNELS = ("battery_power", "soc", "speed")


@click.command()
@click.argument("dataset", type=anywhere)
@click.option("--truck", required=True, help="Truck file, or name of a preset: the nominal model.")
@click.option("--site", type=existing, help="Site or map in place of the one that the dataset was made with.")
@click.option(
    "--against", type=existing, help="Simulated dataset to compare with in place of the nominal model alone."
)
@click.option("--channels", default="", help="Comma-separated: battery_power, soc, speed. All by default.")
@click.option("--terms", default="", help="Comma-separated terms that may be named. All by default.")
@click.option(
    "--holdout",
    type=click.Choice(["trips", "vehicles", "days"]),
    default="trips",
    show_default=True,
    help="What is kept from the search to judge it by.",
)
@click.option(
    "--gate", is_flag=True, help="Exit with 0 only if all channels were judged and nothing is missing."
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of the splits.")
@output_option("Folder to write.")
@overwrite_option
@json_option
@quiet_option
@engine_options
@click.pass_context
def command(
    context: click.Context, dataset: Path, truck: str, site: Path | None, against: Path | None, channels: str,
    terms: str, holdout: str, gate: bool, seed: int, output: Path, overwrite: bool, as_json: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Say where the recording DATASET and the model differ, and what physics was left out.

    Writes diagnosis.json, model.toml with fields/, report.html and recording.rrd.
    """
    from fleetlog.core.truck import load_truck
    from fleetlog.discovery.diagnose import diagnose
    from fleetlog.discovery.report.output import as_result, lines, write_diagnosis
    from fleetlog.physics.power import all_terms
    from fleetlog.roads import load_site
    from fleetlog.store import Dataset
    from fleetlog.store.output import atomic_output
    from fleetlog.view.results import write_result_recording

    recording = Dataset(dataset)
    given = None if site is None else load_site(site)[0]
    options: dict[str, Any] = dict(
        channels=_names(channels, CHANNELS), terms=_names(terms, all_terms()), holdout=holdout, seed=seed
    )
    inputs = named_files(dict(dataset=dataset, truck=truck, site=site, against=against))
    with atomic_output(output, "diagnosis", overwrite=overwrite, inputs=inputs) as folder:
        result = diagnose(
            recording, load_truck(truck), site=given, against=None if against is None else Dataset(against),
            progress=lambda step: notice(f"  {step}", quiet), **options,
        )  # fmt: skip
        write_diagnosis(result, folder)
        write_result_recording(as_result(result), given or recording.site, folder / "recording.rrd")
    verdict = result.verdict
    say(lines(result), {**verdict.document(), "output": str(output)}, as_json=as_json, quiet=quiet)
    if not gate:
        return
    missing = _unjudged(verdict, options["channels"])
    if missing:
        notice(f"fleetlog: the gate stays shut: {', '.join(missing)} could not be judged")
    if missing or not verdict.passes:
        context.exit(1)


def _unjudged(verdict: Verdict, wanted: list[str]) -> list[str]:
    """The channels that the recording has or the user wants, and that have no full set of figures."""
    judged = {c.name for c in verdict.channels if c.judged}
    return [n for n in dict.fromkeys([*(c.name for c in verdict.channels), *wanted]) if n not in judged]


def _names(text: str, known: Collection[str] = ()) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if known and name not in known:
            raise click.UsageError(f"unknown {name!r}; {nearest(name, known)}")
    return names
