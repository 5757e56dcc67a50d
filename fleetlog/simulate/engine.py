"""The simulation: a fixed step for all trucks, decisions once a second, power and rows every ten seconds."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import count
from fleetlog.errors import DataError, SiteError
from fleetlog.listening import progress
from fleetlog.physics.battery import BatteryModel
from fleetlog.physics.power import Physics
from fleetlog.simulate.demand import at_places
from fleetlog.simulate.dispatch import Dispatcher
from fleetlog.simulate.events import EventLog
from fleetlog.simulate.junctions import GAP
from fleetlog.simulate.limits import Summary, Tally
from fleetlog.simulate.occupancy import Policy
from fleetlog.simulate.record import Meter, Recorder, locate
from fleetlog.simulate.state import STANDS, Log, Mode, Trucks, limits_of, new_fleet, new_log
from fleetlog.simulate.tasks import Demand, check_doable
from fleetlog.simulate.world import Crossings, World, build_world, vehicle_names
from fleetlog.store.writer import DatasetWriter

DEFAULT_START = 1_767_592_800_000_000
"""2026-01-05 06:00 UTC, a Monday: fixed, so that the same seed gives the same bytes [us]."""
LONGEST = 2048  # Pieces in a route
TOGETHER = 128  # Trucks whose power is worked out at once: arrays that stay in the processor's cache
BATCH = 10.0  # Power is worked out for so many seconds at once [s]
IN_TRAFFIC = np.isin(np.arange(Mode.EMPTY + 1), (Mode.DRIVING, Mode.AT_BAY, Mode.WANTS_OUT))
"""By activity: a truck that stands meanwhile waits for others."""


@dataclass(frozen=True)
class Settings:
    """How to simulate; times in seconds, ``start`` in microseconds since 1970."""

    vehicles: int = 8
    duration: float = 3600.0
    step: float = 0.1
    interval: float = 1.0
    start: int = DEFAULT_START
    seed: int = 0
    soc: float = 0.95
    temperature: float = 20.0
    policy: Policy = field(default_factory=Policy)
    battery: BatteryModel | None = None
    room: int = 0  # Trucks for which spots are drawn at least: fleets of several sizes meet the same site


def simulate(
    site: Site, truck: Truck | Sequence[Truck], writer: DatasetWriter, settings: Settings | None = None,
    demand: Demand | None = None, physics: Physics | None = None, mined: frozenset[str] = frozenset(),
) -> Summary:  # fmt: skip
    """Simulate a fleet on a site and write its trajectories.

    truck : of all vehicles, or one for each.
    demand : tasks; by default endless ones between random places.
    physics : terms beyond the nominal model; each can be switched off in it.
    mined : places that may be left out where there is no room beside the road.

    :class:`InputError` for an unreachable place, one off the roads, more trucks than the site holds."""
    settings, demand = settings or Settings(), demand or Demand()
    _check(settings)
    # Half the time of a large run is writing, and half of that is packing.
    writer.compression = "snappy"
    trucks = Trucks.given(truck, settings.vehicles)
    begins = settings.start * 1e-6
    world = build_world(site, trucks, settings.vehicles, physics, mined, settings.room, demand.stands, begins)
    loads = [trucks[v].chassis.rated_load for v in range(settings.vehicles)]
    check_doable(demand.given, dict(zip(vehicle_names(settings.vehicles), loads, strict=True)))
    writer.site = world.site
    demand, notes = reachable(demand, world)
    world.notes.extend(notes)
    return Run(world, settings, demand, writer).all()


def reachable(demand: Demand, world: World) -> tuple[Demand, list[str]]:
    """The demand without the given tasks from or to places that have no bay; and what to say about it."""
    known = {bay.place.id for bay in world.bays}
    demand = replace(demand, visits=at_places(demand.visits, known))
    doable = [t for t in demand.given if {t.source, t.target} <= known]
    if not (left_out := [t for t in demand.given if not {t.source, t.target} <= known]):
        return demand, []
    if not doable and not demand.endless:
        source, target = left_out[0].source, left_out[0].target
        what = f"place {target!r} cannot be reached from {source!r} and back, nor any place of another task"
        raise SiteError(what, do="check one-way roads and turns of the map")
    note = f"{count(len(left_out), 'task')} dropped, from or to places that were left out"
    return replace(demand, given=doable, left_out=left_out), [note]


def _check(settings: Settings) -> None:
    n, ratio = settings.vehicles, settings.interval / settings.step
    if n < 1:
        raise DataError(f"{n} vehicles cannot be simulated", do="ask for one at least with --vehicles")
    if not 0.01 <= settings.step <= 0.25:
        raise DataError(f"a step of {settings.step:g} s is too coarse or too fine", do="take 0.01 to 0.25 s")
    if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
        what = f"rows every {settings.interval:g} s are not a whole number of steps of {settings.step:g} s"
        raise DataError(what, do="choose --rate so that 1 / rate is a multiple of --step")
    if settings.duration < settings.interval:
        raise DataError("the duration is shorter than the time between two rows", do="simulate longer")


class Run:
    """One simulation under way."""

    def __init__(self, world: World, settings: Settings, demand: Demand, writer: DatasetWriter) -> None:
        self.world, self.settings, self.names = world, settings, vehicle_names(settings.vehicles)
        trucks, length = world.trucks, world.truck.chassis.length
        dt, n, lanes = settings.step, len(self.names), len(world.track.network)
        self.fleet = new_fleet(n, lanes, len(world.track), len(world.roads.conflict_first) - 1, LONGEST)
        self.second = max(round(1.0 / dt), 1)
        unit = int(np.lcm(self.second, round(settings.interval / dt)))
        self.steps = unit * max(int(np.ceil(BATCH / dt / unit)), 1)
        self.total = int(np.ceil(settings.duration / dt / self.steps)) * self.steps
        self.log = new_log(n, self.steps)
        given = self.names, demand, settings.policy, settings.seed, settings.start * 1e-6
        self.dispatcher = Dispatcher(world, self.fleet, *given)
        self.crossings = Crossings(world.site, world.walks, settings.seed)
        self.tally = Tally(self.dispatcher)
        self.events = EventLog(self.dispatcher, writer, settings.start)
        self.bay_of = np.array([d.bay for d in world.doors], dtype=np.int32)
        self.meter = Meter(world, settings)
        self.recorder = Recorder(writer, self.names, world, settings, self.steps, self.total)
        self.limits = limits_of([p.at(0.0).actual_truck for p in world.physics], trucks.of, length, GAP)
        self.groups = list(trucks.alike(TOGETHER))
        self.soc_lowest, self.soc_sum, self.waiting = settings.soc, 0.0, 0.0

    def all(self) -> Summary:
        """To the end."""
        with self.recorder:
            for step0 in range(0, self.total, self.steps):
                self.batch(step0)
                progress("simulating", (step0 + self.steps) / self.total)
            self.recorder.flush()
        d, total, notes = self.dispatcher, self.total, list(self.world.notes)
        dropped = d.book.numbers("dropped")
        d.count.tasks_given, d.count.tasks_done = len(dropped), int((dropped >= 0.0).sum())
        d.count.tasks_later = len(d.pending)
        if not (d.kind == "charge").any():
            notes.append("the site has no charger: nobody charges")
        rows = total // self.recorder.every * len(self.names)
        summary = Summary(
            len(self.names), total * self.settings.step, rows, total * len(self.names), d.count,
            float(self.fleet.moved.sum()), self.meter.used, self.meter.charged + d.swapped_wh,
            self.meter.soc.tolist(), self.soc_lowest, self.soc_sum / total, self.tally.limits(self.waiting),
            d.watch.longest, notes,
        )  # fmt: skip
        self.events.close(total * self.settings.step)
        return summary

    def batch(self, step0: int) -> None:
        """Some ten seconds of all trucks."""
        from fleetlog.simulate.kernels.traffic import advance

        dt = self.settings.step
        self.dispatcher.soc = self.meter.soc
        bay = self.bay_of[self.fleet.door]
        for k in range(0, self.steps, self.second):
            self.dispatcher.tick((step0 + k) * dt)
            self.crossings.tick((step0 + k) * dt, self.fleet.walked)
            self.tally.tick()
            self.events.tick((step0 + k) * dt)
            advance(self.world.roads, self.fleet, self.limits, self.log, k, self.second, step0 + k, dt)
        self.meter.share_site_power(self.fleet.mode, bay)
        for which in self.groups:
            log = Log._make(values[which] for values in self.log)
            place = locate(self.world.ground, log)
            energy = self.meter.batch(log, place, bay[which], step0, which)
            self.waiting += float(((log.v < STANDS) & IN_TRAFFIC[log.mode]).sum()) * dt
            self.recorder.add(which, log, place | energy)
        self.soc_lowest = min(self.soc_lowest, float(self.meter.soc.min()))
        self.soc_sum += float(self.meter.soc.mean()) * self.steps
        self.recorder.next()
        f = self.fleet
        may = np.isin(f.mode, (Mode.PARKED, Mode.HANDLING, Mode.DRIVING, Mode.AT_BAY, Mode.WANTS_OUT))
        for v in np.flatnonzero(may & (self.meter.soc <= 0.0) & ~f.entry):
            f.mode[v] = Mode.EMPTY
            f.asks[f.asks == v] = -1
            self.dispatcher.count.empty.append(self.names[v])
