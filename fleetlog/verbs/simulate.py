"""Generate the trajectories of a fleet on a site."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fleetlog import scratch
from fleetlog.api import inputs
from fleetlog.api.answer import Answer, dataset_answer, destination
from fleetlog.api.kinds import DatasetLike, PathLike, PhysicsLike, SiteLike, TableLike, TruckLike
from fleetlog.api.verb import verb
from fleetlog.core.arguments import Between, Counts, Duration, Seed, Share, seconds
from fleetlog.errors import ArgumentError, nearest
from fleetlog.listening import notice, progress
from fleetlog.verbs._experiment import is_experiment, run_experiment, settings_file

if TYPE_CHECKING:
    from pathlib import Path

    from fleetlog.core.site import Site
    from fleetlog.physics.power import Physics
    from fleetlog.simulate.scenario import Scenario
    from fleetlog.store import Dataset, DatasetWriter

Asked = SimpleNamespace  # The arguments of :func:`simulate`, converted


@verb(jobs=True, fill=settings_file)
def simulate(
    *, site: SiteLike | None = None, truck: TruckLike, vehicles: Counts | None = None,
    duration: Duration = "1h", like: DatasetLike | None = None,
    same_mission: bool = False, together: bool = False, tasks: TableLike | None = None,
    cycle: Literal["vdi2198"] | None = None,
    close: tuple[str, ...] = (), physics: PhysicsLike | None = None, without: tuple[str, ...] = (),
    seed: Seed = 0, rate: Annotated[float, Between(0.0, 1000.0)] = 1.0,
    step: Annotated[float, Between(0.001, 60.0)] = 0.1, start: str | None = None, soc: Share = 0.95,
    charge_below: Share = 0.3, policy: Literal["opportunity", "threshold"] = "opportunity",
    shadow: bool = True, experiment: PathLike | None = None, vary: tuple[str, ...] = (),
    runs: Annotated[int, Between(1, 10_000, whole=True)] = 1,
    chemistry: Literal["constant", "lfp", "lead"] = "constant",
    temperature: Annotated[float, Between(-80.0, 80.0)] = 20.0, recording: bool = True,
    output: PathLike | None = None, overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Generate the trajectories of a fleet on a site, as a dataset and its replay.

    Parameters
    ----------
    site : site file, or a road map directly; by default that of --like.
    vehicles : number of trucks; by default as many as in --like, else 8. A range (6..14) is an experiment.
    duration : simulated time: 8h, 30m, 600s.
    like : dataset whose places and demand are taken over.
    same_mission : drive the trips of --like again, each by itself, for comparison.
    together : with --same-mission, in one another's way.
    tasks : CSV (in Python also a DataFrame): vehicle (or any), from, to, payload [kg], earliest [s].
    cycle : a test cycle on a strip of its own.
    close : close a road to all trucks; may be repeated.
    physics : model.toml with terms found elsewhere.
    without : leave a term of the physics out; may be repeated.
    rate : rows per second of each truck.
    step : time step of the simulation [s].
    start : UTC, ISO 8601; by default 2026-01-05T06:00, or the start of --like.
    soc : state of charge at the start.
    charge_below : state of charge that sends a truck to charge.
    policy : charge also when there is nothing else to do, or only when --charge-below is reached.
    shadow : simulate what one more truck, plug or place would bring.
    experiment : TOML whose keys are these options, and a table [vary].
    vary : compare: plugs=2..6, close=ROAD,ROAD, policy=..., or room at a place: dock-1=1..3.
    runs : number of seeds of an experiment, from --seed on.
    chemistry : of the battery; constant: constant voltage.
    temperature : of the air [degC].
    recording : write the replay (``fleetlog view`` can make it later).
    output : folder of the dataset.

    Examples
    --------
    >>> import fleetlog
    >>> fleet = fleetlog.simulate(
    ...     site="sample/site.toml", truck="sample/truck.toml", vehicles=3, duration="5m", recording=False
    ... )
    >>> fleet.summary["rows"], fleet.dataset.vehicles
    (900, ['T1', 'T2', 'T3'])
    """
    from fleetlog.store import DatasetWriter
    from fleetlog.store.documents import provenance

    asked = Asked(**locals())
    asked.duration, asked.truck = seconds(duration), inputs.as_truck(truck)
    asked.like = None if like is None else inputs.as_dataset(like)
    _check(asked)
    asked.site = _site(asked)
    asked.physics = _physics(asked)
    read = inputs.files_of(site, truck, like, tasks, physics, experiment)
    if is_experiment(asked):
        return _experiment(asked, read)
    digested = [p for p in inputs.files_of(site, truck, tasks, physics) if p.is_file()]
    target = scratch.folder() / "dataset" if output is None else inputs.as_path(output)
    create = partial(DatasetWriter.create, overwrite=overwrite, inputs=read)
    with create(target, "simulated", asked.site) as writer:
        writer.provenance = provenance(
            digested, seed, like=None if like is None else str(inputs.as_path(like))
        )
        run = _cycle if cycle else _mission if same_mission else _fleet
        writer.summary, lines = run(asked, writer)
        if recording:
            _replay(writer, asked.like)
    return dataset_answer("simulate", target, target if output else None, writer.summary, lines)


def _check(asked: Asked) -> None:
    alone = asked.same_mission or asked.cycle
    if asked.same_mission and asked.like is None:
        raise ArgumentError("--same-mission needs the recording", do="name it with --like")
    if asked.together and not asked.same_mission:
        raise ArgumentError("--together is for recorded missions", do="add --same-mission and --like")
    if asked.close and alone:
        raise ArgumentError("--close is for a fleet: not with --same-mission or --cycle")
    if is_experiment(asked) and alone:
        raise ArgumentError("an experiment is for a fleet: not with --same-mission or --cycle")


def _site(asked: Asked) -> Site:
    if asked.cycle:
        from fleetlog.simulate.cycle import strip

        return strip()
    if asked.site is None and asked.like is None:
        raise ArgumentError("a simulation needs a site", do="name one with --site, or a dataset with --like")
    site: Site = asked.like.site if asked.site is None else inputs.as_site(asked.site)
    return replace(site, network=site.roads().without(asked.close)) if asked.close else site


def _physics(asked: Asked) -> Physics:
    from fleetlog.physics.power import Physics, all_terms

    physics = Physics(asked.truck)
    if asked.physics is not None:
        physics = inputs.as_physics(asked.physics, asked.truck, asked.site.network)
    for name in asked.without:
        if name not in all_terms():
            raise ArgumentError(f"unknown term {name!r}", option="--without", do=nearest(name, all_terms()))
    return replace(physics, off=physics.off | frozenset(asked.without))


def _experiment(asked: Asked, read: list[Path]) -> Answer:
    with destination(asked.output, "analysis", asked.overwrite, read) as keep:
        made = [_scenario(asked, seed) for seed in range(asked.seed, asked.seed + asked.runs)]
        for note in made[0][1]:
            notice(note)
        result = run_experiment(asked, [scenario for scenario, _ in made])
        return keep(Answer.of(result, asked.site))


def _fleet(asked: Asked, writer: DatasetWriter) -> tuple[dict[str, Any], list[str]]:
    from fleetlog.simulate.scenario import one_more

    scenario, notes = _scenario(asked, asked.seed)
    summary = scenario.write(writer, _told)
    if asked.shadow:
        summary.one_more = one_more(scenario, summary)
    for note in (*notes, *summary.notes):
        notice(note)
    return {**summary.to_dict(), "notes": [*notes, *summary.notes]}, summary.lines()


def _told(done: float, total: float) -> None:
    progress("simulating", done / total)


def _scenario(asked: Asked, seed: int) -> tuple[Scenario, list[str]]:
    """What the arguments ask for, with one seed; and notes on it."""
    from fleetlog.physics.battery import battery_of
    from fleetlog.simulate.demand import like as take_over
    from fleetlog.simulate.drivers import recorded_drivers
    from fleetlog.simulate.engine import Settings
    from fleetlog.simulate.occupancy import Policy
    from fleetlog.simulate.scenario import Scenario
    from fleetlog.simulate.tasks import Demand, read_tasks

    site, truck, like = asked.site, asked.truck, asked.like
    # Where the size of the fleet varies, the tasks are those of the recorded fleet.
    recorded = len(like.vehicles) if like else 8
    vehicles = asked.vehicles if isinstance(asked.vehicles, int) else recorded
    start, demand, notes, driven = _start(asked.start, like), Demand(), list[str](), truck
    own = {p.id for p in site.places}
    if like is not None:
        # Another fleet than the recorded one shares the tasks in its own way.
        same = vehicles == recorded and not is_experiment(asked)
        driven = recorded_drivers(like, truck) if same else truck
        site, demand, notes = take_over(like, site, truck, vehicles, start, asked.duration, seed, same)
    if asked.tasks is not None:
        demand = Demand(read_tasks(inputs.as_csv(asked.tasks), site, truck, seed), endless=False)
    battery = None if asked.chemistry == "constant" else battery_of(truck, asked.chemistry)
    settings = Settings(
        vehicles, asked.duration, asked.step, 1.0 / (asked.rate or 1e-9), start, seed, asked.soc,
        asked.temperature, Policy.named(asked.policy, asked.charge_below), battery,
    )  # fmt: skip
    mined = frozenset(p.id for p in site.places) - own
    return Scenario(site, driven, settings, demand, asked.physics, mined), notes


def _mission(asked: Asked, writer: DatasetWriter) -> tuple[dict[str, Any], list[str]]:
    from fleetlog.simulate.mission import replay

    writer.site = asked.like.site
    summary = replay(asked.like, asked.truck, writer, asked.physics, _told, asked.together)
    lines = [
        f"{summary.trips} trips of {summary.vehicles} trucks driven again, {summary.rows} rows",
        f"simulated / recorded: distance {summary.distance_ratio:.3f}, driving {summary.duration_ratio:.3f}, "
        f"energy {summary.energy_ratio:.3f}",
    ]
    if summary.own_path:
        lines.append(f"{summary.own_path} trips follow their recorded positions: they are not on the roads")
    if summary.lost_share is not None:
        lines.append(f"traffic: {100.0 * summary.lost_share:.1f} % of the travel time lost to other trucks")
    return {k: v for k, v in asdict(summary).items() if v is not None}, lines


def _cycle(asked: Asked, writer: DatasetWriter) -> tuple[dict[str, Any], list[str]]:
    from fleetlog.simulate.cycle import run_cycle

    start = _start(asked.start, None)
    watts = run_cycle(asked.cycle, asked.truck, asked.duration, writer, asked.physics, start, asked.soc)
    line = f"{asked.cycle}: {watts / 1000.0:.3f} kWh/h at the battery"
    return {"cycle": asked.cycle, "mean_power_w": watts}, [line]


def _start(text: str | None, like: Dataset | None) -> int:
    import numpy as np

    from fleetlog.simulate.engine import DEFAULT_START

    given = text or (like.meta["start"] if like is not None else None)
    if given is None:
        return DEFAULT_START
    try:
        start: Any = np.datetime64(str(given).removesuffix("Z"), "us")
    except ValueError:
        start = np.datetime64("NaT")
    if not np.datetime64("1970-01-01") <= start < np.datetime64("2200-01-01"):  # NaT is not either
        what = f"{given!r} is no time between the years 1970 and 2200; write 2026-01-05T06:00"
        raise ArgumentError(what, option="--start")
    return int(start.astype(np.int64))


def _replay(writer: DatasetWriter, recorded: Dataset | None) -> None:
    """The recording of the simulation; beside the recorded fleet, where there is one to compare it with."""
    from fleetlog.view.comparison import write_comparison
    from fleetlog.view.recording import write_recording

    writer.finish()
    target = writer.path / "recording.rrd"
    if recorded is None:
        write_recording(writer.path, target)
    else:
        write_comparison(recorded.path, writer.path, target)
