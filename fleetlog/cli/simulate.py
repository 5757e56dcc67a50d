"""``fleetlog simulate``: a fleet on a site, a recording's mission again, or a test cycle."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fleetlog.cli.experiment import Counts, experiment_options, is_experiment, run_experiment, seeds
from fleetlog.cli.options import (
    SEED,
    Between,
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
from fleetlog.cli.output import write_analysis

if TYPE_CHECKING:
    from fleetlog.core.site import Site
    from fleetlog.core.truck import Truck
    from fleetlog.physics.power import Physics
    from fleetlog.simulate.scenario import Scenario
    from fleetlog.store import Dataset, DatasetWriter

UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
LONGEST = 366 * 86400.0


class Duration(click.ParamType):  # type: ignore[type-arg]  # generic in newer releases of click only
    """``8h``, ``90m``, ``1.5h``, ``600`` (seconds)."""

    name = "duration"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Seconds."""
        if isinstance(value, float):
            return value
        found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|m|min|h|d)?\s*", str(value))
        if not found:
            self.fail(f"{value!r} is no duration; write 8h, 30m or 600s", param, ctx)
        seconds = float(found[1]) * UNITS[found[2] or "s"]
        if seconds > LONGEST:
            self.fail(f"{value!r} is longer than {LONGEST / 86400.0:.0f} days", param, ctx)
        return seconds


@click.command()
@click.option("--site", type=existing, help="Site file, or a road map directly; by default that of --like.")
@click.option("--truck", required=True, help="Truck file, or name of a preset.")
@click.option(
    "--vehicles", type=Counts(), help="Trucks; by default as many as in --like, else 8. 6..14: an experiment."
)
@click.option("--duration", type=Duration(), default="1h", show_default=True, help="8h, 30m, 600s.")
@click.option("--like", type=existing, help="Dataset whose places and demand are taken over.")
@click.option(
    "--same-mission", is_flag=True, help="Drive the trips of --like again, each by itself, for comparison."
)
@click.option("--tasks", type=existing, help="CSV: vehicle (or any), from, to, payload [kg], earliest [s].")
@click.option("--cycle", help="A test cycle on a strip of its own: vdi2198.")
@click.option("--close", multiple=True, metavar="ROAD", help="Let nobody drive on a road; may be repeated.")
@click.option("--physics", type=existing, help="model.toml with terms found elsewhere.")
@click.option(
    "--without", multiple=True, metavar="TERM", help="Leave a term of the physics out; may be repeated."
)
@click.option("--seed", type=SEED, default=0, show_default=True, help="Same seed, same bytes.")
@click.option(
    "--rate", type=Between(0.0, 1000.0), default=1.0, show_default=True, help="Rows a second of each truck."
)
@click.option(
    "--step", type=Between(0.001, 60.0), default=0.1, show_default=True, help="Of the simulation [s]."
)
@click.option("--start", help="UTC, ISO 8601; by default 2026-01-05T06:00, or the start of --like.")
@click.option(
    "--soc", type=Between(0.0, 1.0), default=0.95, show_default=True, help="State of charge at the start."
)
@click.option(
    "--charge-below",
    type=Between(0.0, 1.0),
    default=0.3,
    show_default=True,
    help="State of charge that sends a truck to charge.",
)
@click.option(
    "--policy", type=click.Choice(["opportunity", "threshold"]), default="opportunity", show_default=True,
    help="Charge also when there is nothing else to do, or only when --charge-below is reached.",
)  # fmt: skip
@click.option("--no-shadow", is_flag=True, help="Do not simulate what one more of what limits would bring.")
@experiment_options
@click.option(
    "--chemistry", type=click.Choice(["nominal", "lfp", "lead"]), default="nominal", show_default=True,
    help="Of the battery; nominal: constant voltage.",
)  # fmt: skip
@click.option(
    "--temperature", type=Between(-80.0, 80.0), default=20.0, show_default=True, help="Of the air [degC]."
)
@click.option("--no-recording", is_flag=True, help="Leave the replay out (fleetlog view can make it later).")
@output_option("Folder of the dataset.")
@json_option
@overwrite_option
@quiet_option
@engine_options
def command(output: Path, as_json: bool, overwrite: bool, quiet: bool, **options: Any) -> None:
    """Generate the trajectories of a fleet on a site, as a dataset and its replay."""
    from fleetlog.core.truck import load_truck
    from fleetlog.store import Dataset, DatasetWriter
    from fleetlog.store.provenance import provenance

    truck = load_truck(options["truck"])
    like = Dataset(options["like"]) if options["like"] else None
    if options["same_mission"] and like is None:
        raise click.UsageError("--same-mission needs the recording: name it with --like")
    if options["close"] and (options["same_mission"] or options["cycle"]):
        raise click.UsageError("--close is for a fleet: not with --same-mission or --cycle")
    site = _site(options, like, quiet)
    if options["close"]:
        site = replace(site, network=site.roads().without(options["close"]))
    physics = _physics(options, truck, site)
    if is_experiment(options):
        if options["same_mission"] or options["cycle"]:
            raise click.UsageError("an experiment is for a fleet: not with --same-mission or --cycle")
        with _progress(quiet) as progress:
            made = [_scenario(options, truck, physics, like, site, seed) for seed in seeds(options)]
            for note in made[0][1]:
                notice(note, quiet)
            result = run_experiment(options, [scenario for scenario, _ in made], progress)
        write_analysis(result, site, output, overwrite, named_files(options))
        say([*result.lines, f"experiment: {output}"], result.summary, as_json=as_json, quiet=quiet)
        return
    with (
        _progress(quiet) as progress,
        DatasetWriter.create(
            output, "simulated", site, overwrite=overwrite, inputs=named_files(options)
        ) as writer,
    ):
        inputs = [
            Path(options[k])
            for k in ("site", "truck", "tasks", "physics")
            if options[k] and Path(options[k]).is_file()
        ]
        writer.provenance = provenance(inputs, options["seed"], like=str(options["like"] or "") or None)
        run = _cycle if options["cycle"] else _mission if options["same_mission"] else _fleet
        summary, lines = run(options, truck, physics, like, writer, progress, quiet)
        writer.summary = summary
        if not options["no_recording"]:
            _replay(writer, like if options["same_mission"] or like is not None else None)
    say([*lines, f"dataset: {output}"], {**summary, "dataset": str(output)}, as_json=as_json, quiet=quiet)


def _site(options: dict[str, Any], like: Dataset | None, quiet: bool) -> Site:
    if options["cycle"]:
        from fleetlog.simulate.cycle import strip

        return strip()
    if options["site"]:
        from fleetlog.roads import load_site

        site, reports = load_site(options["site"])
        for report in reports:
            notice(report.line(), quiet)
        return site
    if like is None:
        raise click.UsageError("say where with --site, or like which recording with --like")
    return like.site


def _physics(options: dict[str, Any], truck: Truck, site: Site) -> Physics:
    from fleetlog.errors import nearest
    from fleetlog.physics.model import load_physics
    from fleetlog.physics.power import Physics, all_terms

    physics = load_physics(options["physics"], truck, site.network) if options["physics"] else Physics(truck)
    for name in options["without"]:
        if name not in all_terms():
            raise click.UsageError(f"--without: unknown term {name!r}; {nearest(name, all_terms())}")
    return replace(physics, off=physics.off | frozenset(options["without"]))


def _fleet(
    options: dict[str, Any], truck: Truck, physics: Physics, like: Dataset | None, writer: DatasetWriter,
    progress: Callable[[float, float], None], quiet: bool,
) -> tuple[dict[str, Any], list[str]]:  # fmt: skip
    from fleetlog.simulate.scenario import one_more

    scenario, notes = _scenario(options, truck, physics, like, writer.site, options["seed"])
    for note in notes:
        notice(note, quiet)
    summary = scenario.write(writer, progress)
    if not options["no_shadow"]:
        summary.one_more = one_more(scenario, summary)
    for note in summary.notes:
        notice(note, quiet)
    return {**summary.to_dict(), "notes": [*notes, *summary.notes]}, summary.lines()


def _scenario(
    options: dict[str, Any], truck: Truck, physics: Physics, like: Dataset | None, site: Site, seed: int
) -> tuple[Scenario, list[str]]:
    """What the options ask for, with one seed; and notes to say aloud."""
    from fleetlog.physics.battery import battery_of
    from fleetlog.simulate.dispatch import Policy
    from fleetlog.simulate.engine import Settings
    from fleetlog.simulate.places import like as take_over
    from fleetlog.simulate.scenario import Scenario
    from fleetlog.simulate.tasks import Demand, read_tasks

    # Where the fleet varies the tasks are those of the recorded fleet.
    fleet = options["vehicles"] if isinstance(options["vehicles"], int) else None
    vehicles = fleet if fleet is not None else (len(like.vehicles) if like else 8)
    start, demand, notes = _start(options["start"], like), Demand(), list[str]()
    own = {p.id for p in site.places}
    if like is not None:
        # Another fleet than the recorded one has its own way of sharing the tasks out.
        same = vehicles == len(like.vehicles) and not is_experiment(options)
        site, tasks, notes = take_over(like, site, truck, vehicles, start, options["duration"], seed, same)
        demand = Demand(tasks, endless=not tasks, stay=same)
    if options["tasks"]:
        demand = Demand(read_tasks(options["tasks"], site, truck, seed), endless=False)
    battery = None if options["chemistry"] == "nominal" else battery_of(truck, options["chemistry"])
    rate = options["rate"] if options["rate"] > 0.0 else 1e-9
    settings = Settings(
        vehicles, options["duration"], options["step"], 1.0 / rate, start, seed, options["soc"],
        options["temperature"], Policy.named(options["policy"], options["charge_below"]), battery,
    )  # fmt: skip
    mined = frozenset(p.id for p in site.places) - own
    return Scenario(site, truck, settings, demand, physics, mined), notes


def _mission(
    options: dict[str, Any], truck: Truck, physics: Physics, like: Dataset | None, writer: DatasetWriter,
    progress: Callable[[float, float], None], quiet: bool,
) -> tuple[dict[str, Any], list[str]]:  # fmt: skip
    from fleetlog.simulate.mission import replay

    assert like is not None
    writer.site = like.site
    summary = replay(like, truck, writer, physics, progress)
    lines = [
        f"{summary.trips} trips of {summary.vehicles} trucks driven again, {summary.rows} rows",
        f"simulated / recorded: distance {summary.distance_ratio:.3f}, driving {summary.duration_ratio:.3f}, "
        f"energy {summary.energy_ratio:.3f}",
    ]
    if summary.own_path:
        lines.append(f"{summary.own_path} trips follow their recorded positions: they are not on the roads")
    return asdict(summary), lines


def _cycle(
    options: dict[str, Any], truck: Truck, physics: Physics, like: Dataset | None, writer: DatasetWriter,
    progress: Callable[[float, float], None], quiet: bool,
) -> tuple[dict[str, Any], list[str]]:  # fmt: skip
    from fleetlog.simulate.cycle import run_cycle

    watts = run_cycle(
        options["cycle"],
        truck,
        options["duration"],
        writer,
        physics,
        _start(options["start"], None),
        options["soc"],
    )
    return {"cycle": options["cycle"], "mean_power_w": watts}, [
        f"{options['cycle']}: {watts / 1000.0:.3f} kWh/h at the battery"
    ]


def _start(text: str | None, like: Dataset | None) -> int:
    import numpy as np

    from fleetlog.simulate.engine import DEFAULT_START

    given = text or (like.meta["start"] if like is not None else None)
    if given is None:
        return DEFAULT_START
    try:
        start = np.datetime64(str(given).removesuffix("Z"), "us")
    except ValueError:
        raise click.UsageError(f"--start {given!r} is no time; write 2026-01-05T06:00") from None
    if not np.datetime64("1970-01-01") <= start < np.datetime64("2200-01-01"):  # NaT is not either
        raise click.UsageError(f"--start {given!r} is not between the years 1970 and 2200")
    return int(start.astype(np.int64))


def _replay(writer: DatasetWriter, recorded: Dataset | None) -> None:
    """The recording of the simulation; beside the recorded fleet, where there is one to compare it with."""
    from fleetlog.view.comparison import write_comparison
    from fleetlog.view.recording import write_recording

    writer.finish()
    target = writer.path / "recording.rrd"
    if recorded is not None:
        write_comparison(recorded.path, writer.path, target)
    else:
        write_recording(writer.path, target)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[float, float], None]]:
    """A bar on a terminal, nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("simulate", total=1.0)
        yield lambda done, total: bar.update(task, completed=done / total)
