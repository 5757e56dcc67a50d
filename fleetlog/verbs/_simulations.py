"""What the arguments of ``simulate`` ask for: a fleet, recorded trips again, a test cycle, an experiment."""

from dataclasses import asdict, replace
from functools import partial
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fleetlog import scratch
from fleetlog.api import inputs
from fleetlog.api.answer import Answer, dataset_answer, destination, write_folder
from fleetlog.core.arguments import factor, moment, seconds
from fleetlog.core.files import is_url
from fleetlog.core.site import Site
from fleetlog.core.words import Sentences
from fleetlog.errors import EXIT_DAMAGED, ArgumentError, FleetlogError, InputError, chosen
from fleetlog.listening import notice
from fleetlog.physics.battery import battery_of
from fleetlog.physics.power import Physics, all_terms
from fleetlog.simulate import demand as demands
from fleetlog.simulate.demand import recorded_drivers
from fleetlog.simulate.engine import DEFAULT_START, Settings
from fleetlog.simulate.mission import replay
from fleetlog.simulate.occupancy import Policy
from fleetlog.simulate.retrace import run_cycle, strip
from fleetlog.simulate.scenario import Scenario, experiment, one_more, variants
from fleetlog.simulate.tasks import LEFT_OUT, Demand, read_tasks
from fleetlog.store import DatasetWriter
from fleetlog.store.documents import provenance
from fleetlog.verbs.simulate import simulate

SAID = Sentences(__file__)
Asked = SimpleNamespace  # The arguments of :func:`fleetlog.verbs.simulate.simulate`, converted
Told = tuple[dict[str, Any], list[str]]  # A summary, and the same in sentences
FLEET = "vehicles tasks close vary runs rate step charge_below policy chemistry "
UNUSED = {  # Options that runs of no fleet have no use for
    "same_mission": FLEET + "cycle duration start soc",
    "cycle": FLEET + "site like together temperature",
}
NEEDED = {"same_mission": "like", "together": "same_mission"}


def answer(asked: Asked) -> Answer:
    """Run what is asked for."""
    read = inputs.files_of(asked.site, asked.truck, asked.like, asked.tasks, asked.physics, asked.experiment)
    like = None if asked.like is None else str(inputs.as_path(asked.like))
    _check(asked)
    asked.varies = bool(asked.vary) or asked.runs != 1 or isinstance(asked.vehicles, str)
    asked.duration, asked.truck = seconds(asked.duration), inputs.as_truck(asked.truck)
    asked.like = None if like is None else inputs.as_dataset(asked.like)
    given = asked.site
    site: Site = strip() if asked.cycle else inputs.as_site(given) if given is not None else asked.like.site
    asked.site = replace(site, network=site.roads().without(asked.close)) if asked.close else site
    sources = [*read, asked.like.path] if like and is_url(like) else read
    asked.origin = {"inputs": sources, "seed": asked.seed, "site": asked.site if given is not None else None}
    if asked.start is None:
        recorded = asked.like is not None and asked.like.rows
        asked.start = moment(asked.like.meta["start"]) if recorded else DEFAULT_START
    physics = Physics(asked.truck)
    if asked.physics is not None:
        physics = inputs.as_physics(asked.physics, asked.truck, asked.site.network)
    for name in asked.without:
        chosen(all_terms(), name, f"unknown term {name!r}", ArgumentError, where="--without")
    asked.physics = replace(physics, off=physics.off | frozenset(asked.without))
    if asked.varies:
        return _experiment(asked, read)
    target = scratch.folder() / "dataset" if asked.output is None else inputs.as_path(asked.output)
    over = asked.overwrite
    with DatasetWriter.create(target, "simulated", asked.site, overwrite=over, inputs=read) as writer:
        writer.provenance = provenance(**asked.origin, like=like, truck=asdict(asked.truck.chassis))
        run = _cycle if asked.cycle else _mission if asked.same_mission else _fleet
        writer.summary, lines = run(asked, writer)
        if asked.recording:
            from fleetlog.view.comparison import write_comparison
            from fleetlog.view.recording import write_recording

            writer.finish()
            replayed = writer.path / "recording.rrd"
            if asked.like is None:
                write_recording(writer.path, replayed)
            else:  # beside the recorded fleet, to compare the two
                write_comparison(asked.like.path, writer.path, replayed)
    made = dataset_answer("simulate", target, target if asked.output else None, writer.summary, lines)
    if asked.tasks is not None and (made.tables["tasks"].status == LEFT_OUT).any():
        made.status, made.warning = EXIT_DAMAGED, f"tasks were {LEFT_OUT}; see status in tasks.parquet"
    return made


def _check(asked: Asked) -> None:
    options = signature(simulate).parameters.items()
    given = {name for name, o in options if str(getattr(asked, name, None)) != str(o.default)}
    wrong = [f"--{a} goes with --{b}; add --{b}" for a, b in NEEDED.items() if a in given and b not in given]
    wrong += [f"--{a} does not go with --{b}" for b in UNUSED for a in UNUSED[b].split() if {a, b} <= given]
    if not given & {"site", "like", "cycle"}:
        wrong.append("a simulation needs a site; name one with --site, or a dataset with --like")
    if wrong:
        raise ArgumentError(wrong[0].replace("_", "-"))


def _experiment(asked: Asked, read: list[Path]) -> Answer:
    from fleetlog.report.content import experiment_page

    factors, fleet = list(asked.vary), asked.vehicles
    with destination(asked.output, "experiment", asked.overwrite, read) as keep:
        made = [_scenario(asked, seed) for seed in range(asked.seed, asked.seed + asked.runs)]
        for note in made[0][1]:
            notice(note if all(note in notes for _, notes in made) else f"seed {asked.seed}: {note}")
        bases = [scenario for scenario, _ in made]
        if isinstance(fleet, str) or not factors:
            factors.insert(0, factor(f"vehicles={fleet or bases[0].settings.vehicles}"))
        try:
            variants(bases[0], factors)
        except FleetlogError as error:
            where = next((f.file for f in asked.vary), None) or ("--vary" if asked.vary else "--vehicles")
            wrong = InputError if isinstance(where, Path) else ArgumentError
            raise wrong(error.what, where=where, do=error.do) from None
        result = experiment(bases, factors)
        result.summary["provenance"] = provenance(**asked.origin)
        page = experiment_page(result, asked.site)
        write = partial(write_folder, result, asked.site, page=page, recording=asked.recording)
        return keep(Answer.of(result, asked.site, page=page, write=write))


def _fleet(asked: Asked, writer: DatasetWriter) -> Told:
    scenario, notes = _scenario(asked, asked.seed)
    summary = scenario.write(writer)
    if asked.shadow:
        summary.one_more = one_more(scenario, summary)
    for note in (*notes, *summary.notes):
        notice(note)
    return {**summary.to_dict(), "notes": [*notes, *summary.notes]}, summary.lines()


def _scenario(asked: Asked, seed: int) -> tuple[Scenario, list[str]]:
    """What the arguments ask for, with one seed; and notes on it."""
    site, truck, like = asked.site, asked.truck, asked.like
    # Where the size of the fleet varies, the tasks are those of the recorded fleet.
    recorded = len(like.vehicles) if like else 8
    vehicles = asked.vehicles if isinstance(asked.vehicles, int) else recorded
    start, demand, driven, (notes, untold) = asked.start, Demand(), truck, (list[str](), list[str]())
    own = {p.id for p in site.places}
    if like is not None:
        # Another fleet than the recorded one shares the tasks in its own way.
        same = vehicles == recorded and not asked.varies
        driven, untold = recorded_drivers(like, truck) if same else (truck, [])
        site, demand, notes = demands.like(like, site, truck, vehicles, start, asked.duration, seed, same)
    if asked.tasks is not None:
        demand = read_tasks(inputs.as_csv(asked.tasks), site, truck, seed, start)
    battery = None if asked.chemistry == "constant" else battery_of(truck, asked.chemistry)
    settings = Settings(
        vehicles, asked.duration, asked.step, 1.0 / asked.rate, start, seed, asked.soc,
        asked.temperature, Policy.named(asked.policy, asked.charge_below), battery,
    )  # fmt: skip
    mined = frozenset(p.id for p in site.places) - own
    return Scenario(site, driven, settings, demand, asked.physics, mined), [*notes, *demand.notes, *untold]


def _mission(asked: Asked, writer: DatasetWriter) -> Told:
    writer.site = asked.like.site
    s = replay(asked.like, asked.truck, writer, asked.physics, asked.together, asked.temperature)
    told = ["again", "over", *["own_path"] * bool(s.own_path), *["lost"] * (s.lost_share is not None)]
    return {k: v for k, v in asdict(s).items() if v is not None}, [SAID(name, run=s) for name in told]


def _cycle(asked: Asked, writer: DatasetWriter) -> Told:
    a = asked
    watts = run_cycle(a.cycle, a.truck, a.duration, writer, a.physics, a.start, a.soc)
    line = f"{a.cycle}: {watts / 1000.0:.3f} kWh/h at the battery"
    return {"cycle": a.cycle, "mean_power_w": watts}, [line]
