"""Generate the trajectories of a fleet on a site."""

from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

from fleetlog.api.answer import Answer
from fleetlog.api.inputs import DatasetLike, PathLike, PhysicsLike, SiteLike, TableLike, TruckLike
from fleetlog.api.verb import Option, verb
from fleetlog.core.arguments import Between, Counts, Duration, Factors, Moment, Seed, Share
from fleetlog.core.schema import load_toml
from fleetlog.errors import ArgumentError, InputError, chosen

FILES = ("site", "truck", "like", "tasks", "physics")


def settings_file(given: dict[str, Any], options: dict[str, Option]) -> dict[str, Any]:
    """Add the arguments that are not given from the TOML file ``experiment``, if there is one."""
    if given.get("experiment") is None:
        return given
    path, filled = Path(given["experiment"]), dict[str, Any]()
    if not (table := load_toml(path)):
        raise InputError("holds no setting", where=path, do="see docs/simulate.md")
    if not isinstance(vary := table.pop("vary", {}), dict):
        raise InputError("is not a table", where=path, place="vary", do="write [vary]")
    if vary:
        table["vary"] = [f"{name}={','.join(_texts(values))}" for name, values in vary.items()]
    for key, value in table.items():
        name, texts = key.replace("-", "_"), _texts(value)
        option = chosen(options, name, "unknown key", InputError, where=path, place=name)
        if isinstance(value, list) and not option.many:
            raise InputError("takes one value", where=path, place=name)
        filled[name] = value if option.flag else texts if option.many else texts[0]
        if name in FILES:
            with suppress(OSError, ValueError):  # what cannot be a name is none of a file
                (path.parent / texts[0]).stat()
                filled[name] = str(path.parent / texts[0])
        try:
            checked = option.convert(filled[name])
        except ArgumentError as error:
            raise InputError(error.what, where=path, place=name) from None
        if name == "vary":
            filled[name] = [one._replace(file=path) for one in checked]
    return {**filled, **given}


def _texts(value: Any) -> list[str]:
    """A value, or several, as a command line would have them."""
    return [str(v) for v in (value if isinstance(value, list) else [value])]


@verb(jobs=True, fill=settings_file)
def simulate(
    *, site: SiteLike | None = None, truck: TruckLike, vehicles: Counts | None = None,
    duration: Duration = "1h", like: DatasetLike | None = None,
    same_mission: bool = False, together: bool = False, tasks: TableLike | None = None,
    cycle: Literal["vdi2198"] | None = None,
    close: tuple[str, ...] = (), physics: PhysicsLike | None = None, without: tuple[str, ...] = (),
    seed: Seed = 0, rate: Annotated[float, Between(0.0, 1000.0, above=True)] = 1.0,
    step: Annotated[float, Between(0.01, 0.25)] = 0.1, start: Moment | None = None, soc: Share = 0.95,
    charge_below: Share = 0.3, policy: Literal["opportunity", "threshold"] = "opportunity",
    shadow: bool = True, experiment: PathLike | None = None, vary: Factors = (),
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
    together : with --same-mission, let the trucks be in one another's way.
    tasks : CSV (in Python also a DataFrame): vehicle (or any), from, to, payload [kg], earliest [s].
    cycle : a test cycle on a strip of its own.
    close : close a road to all trucks; may be repeated.
    without : leave a term of the physics out; may be repeated.
    rate : rows per second of each truck.
    step : time step of the simulation [s].
    start : start of the simulation (UTC, ISO 8601); by default 2026-01-05T06:00, or the start of --like.
    soc : state of charge at the start.
    charge_below : state of charge that sends a truck to charge.
    policy : charge also when there is nothing else to do, or only when --charge-below is reached.
    shadow : simulate what one more truck, plug or place would bring.
    experiment : TOML whose keys are these options, and a table [vary].
    vary : compare: plugs=2..6, close=ROAD,ROAD, policy=..., or room at a place: dock-1=1..3.
    runs : number of seeds of an experiment, from --seed on.
    chemistry : chemistry of the battery; constant: constant voltage.
    temperature : temperature of the air; with --same-mission where the recording has none [degC].
    output : folder of the dataset.

    Examples
    --------
    >>> import fleetlog
    >>> fleet = fleetlog.simulate(
    ...     site="sample/site.toml", truck="sample/truck.toml", vehicles=3, duration="5m", recording=False
    ... )
    >>> fleet.summary["rows"], fleet.dataset.vehicles
    (900, ['T1', 'T2', 'T3'])"""
    asked = SimpleNamespace(**locals())
    from fleetlog.verbs._simulations import answer

    return answer(asked)
