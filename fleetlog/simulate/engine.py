"""The simulation: a fixed step for all trucks, decisions once a second, power and rows every ten seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError, SiteError
from fleetlog.physics.battery import BatteryModel
from fleetlog.physics.power import Physics
from fleetlog.simulate.dispatch import Count, Dispatcher, Policy
from fleetlog.simulate.energy import Meter, locate
from fleetlog.simulate.events import EventLog
from fleetlog.simulate.junctions import GAP
from fleetlog.simulate.record import Recorder, columns_of
from fleetlog.simulate.state import (
    AT_BAY,
    CHARGING,
    DRIVING,
    EMPTY,
    HANDLING,
    PARKED,
    STANDS,
    WANTS_OUT,
    limits_of,
    log_of,
    new_fleet,
    new_log,
)
from fleetlog.simulate.tasks import Demand, check_vehicles
from fleetlog.simulate.world import World, build_world
from fleetlog.store.writer import DatasetWriter

DEFAULT_START = 1_767_592_800_000_000
"""2026-01-05 06:00 UTC, a Monday: fixed, so that the same seed gives the same bytes [us]."""
LONGEST = 2048
"""Pieces in a route."""
TOGETHER = 128
"""Trucks whose power is worked out at once: arrays that stay in the processor's cache take half the time."""
BATCH = 10.0
"""Power is worked out for so many seconds at once [s]."""
IN_TRAFFIC = np.isin(np.arange(EMPTY + 1), (DRIVING, AT_BAY, WANTS_OUT))
"""By activity: a truck that stands meanwhile waits for others."""
Progress = Callable[[float, float], None]


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


@dataclass
class Summary:
    """What was simulated."""

    vehicles: int
    duration_s: float
    rows: int
    vehicle_steps: int
    count: Count
    distance_m: float
    energy_wh: float
    charged_wh: float
    soc_end: list[float]
    waiting_s: float
    longest_wait_s: float
    """Longest time that a truck which wanted to move stood on end."""
    unfinished: int
    notes: list[str]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        c = self.count
        return {
            "vehicles": self.vehicles, "duration_s": self.duration_s, "rows": self.rows,
            "vehicle_steps": self.vehicle_steps, "tasks_given": c.tasks_given, "tasks_done": c.tasks_done,
            "tasks_unfinished": self.unfinished, "distance_m": round(self.distance_m, 1),
            "energy_wh": round(self.energy_wh, 2), "charged_wh": round(self.charged_wh, 2),
            "soc_end": [round(s, 5) for s in self.soc_end], "waiting_s": round(self.waiting_s, 1),
            "longest_wait_s": round(self.longest_wait_s, 1),
            "charges": c.charges, "deadlocks": c.deadlocks, "deadlocks_released": c.deadlocks_released,
            "detours": c.detours, "made_room": c.made_room, "empty": c.empty, "notes": self.notes,
        }  # fmt: skip

    def lines(self) -> list[str]:
        """For the terminal."""
        c = self.count
        out = [
            f"{self.vehicles} trucks, {self.duration_s / 3600.0:.2f} h, {self.rows} rows, {self.distance_m / 1000.0:.1f} km",
            f"tasks: {c.tasks_done} done of {c.tasks_given}, {self.unfinished} not finished at the end",
            f"energy: {self.energy_wh / 1000.0:.2f} kWh used, {self.charged_wh / 1000.0:.2f} kWh charged in {c.charges} visits",
            f"traffic: {self.waiting_s / 3600.0:.2f} truck hours of waiting, {self.longest_wait_s:.0f} s at most,"
            f" {c.deadlocks} deadlocks ({c.deadlocks_released} released), {c.detours} detours",
        ]
        if c.empty:
            out.append(f"battery empty: {', '.join(c.empty)}")
        return out


def simulate(
    site: Site,
    truck: Truck,
    writer: DatasetWriter,
    settings: Settings | None = None,
    demand: Demand | None = None,
    physics: Physics | None = None,
    progress: Progress | None = None,
    names: list[str] | None = None,
    mined: frozenset[str] = frozenset(),
) -> Summary:
    """Simulate a fleet on a site and write its trajectories.

    Parameters
    ----------
    site, truck : where and with what.
    writer : takes the rows; :meth:`DatasetWriter.create` made it.
    demand : tasks; by default endless ones between random places.
    physics : terms beyond the nominal model; each can be switched off in it.
    progress : called with seconds done and in all.
    names : vehicle ids; by default T1, T2, ...
    mined : places that may be left out where there is no room beside the road.

    Raises
    ------
    SiteError, InputError
        For an unreachable place, one off the roads, more trucks than the site can hold.
    """
    settings, demand = settings or Settings(), demand or Demand()
    names = names or vehicle_names(settings.vehicles)
    _check(settings)
    # Half the time of a large run is writing, and half of that is packing.
    writer.compression = "snappy"
    world = build_world(site, truck, settings.vehicles, physics, mined)
    check_vehicles(demand.given, names)
    writer.site = world.site
    demand, notes = reachable(demand, world)
    world.notes.extend(notes)
    run = Run(world, settings, demand, names, writer)
    return run.all(progress)


def reachable(demand: Demand, world: World) -> tuple[Demand, list[str]]:
    """The demand without the given tasks from or to places that have no bay; and what to say about it."""
    known = set(world.by_place)
    doable = [t for t in demand.given if {t.source, t.target} <= known]
    left_out = [t for t in demand.given if not {t.source, t.target} <= known]
    if not left_out:
        return demand, []
    if not doable and not demand.endless:
        first = left_out[0]
        raise SiteError(
            f"place {first.target!r} cannot be reached from {first.source!r} and back, nor any place of another task",
            do="check one-way roads and turns of the map",
        )
    note = f"{len(left_out)} tasks from or to places that were left out are dropped"
    return Demand(doable, demand.endless, demand.pause, left_out), [note]


def vehicle_names(n: int) -> list[str]:
    """T1 ... Tn, padded to one width."""
    width = len(str(n))
    return [f"T{i + 1:0{width}d}" for i in range(n)]


def _check(settings: Settings) -> None:
    if settings.vehicles < 1:
        raise DataError(
            f"{settings.vehicles} vehicles cannot be simulated", do="ask for one at least with --vehicles"
        )
    if not 0.01 <= settings.step <= 0.25:
        raise DataError(f"a step of {settings.step:g} s is too coarse or too fine", do="take 0.01 to 0.25 s")
    ratio = settings.interval / settings.step
    if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
        raise DataError(
            f"rows every {settings.interval:g} s are not a whole number of steps of {settings.step:g} s",
            do="choose --rate so that 1 / rate is a multiple of --step",
        )
    if settings.duration < settings.interval:
        raise DataError("the duration is shorter than the time between two rows", do="simulate longer")


class Run:
    """One simulation under way."""

    def __init__(
        self, world: World, settings: Settings, demand: Demand, names: list[str], writer: DatasetWriter
    ) -> None:
        self.world, self.settings, self.names = world, settings, names
        dt, n, lanes = settings.step, len(names), len(world.track.network)
        self.fleet = new_fleet(n, lanes, len(world.track), len(world.roads.conflict_first) - 1, LONGEST)
        self.second = max(round(1.0 / dt), 1)
        every = round(settings.interval / dt)
        unit = int(np.lcm(self.second, every))
        self.steps = unit * max(int(np.ceil(BATCH / dt / unit)), 1)
        self.total = int(np.ceil(settings.duration / dt / self.steps)) * self.steps
        self.log = new_log(n, self.steps)
        self.dispatcher = Dispatcher(world, self.fleet, names, demand, settings.policy, settings.seed)
        self.dispatcher.settle()
        self.events = EventLog(self.dispatcher, writer, settings.start)
        charger = np.array([b.place.power if b.place.kind == "charge" else np.nan for b in world.bays])
        self.bay_of = np.array([d.bay for d in world.doors], dtype=np.int32)
        soc = np.full(n, settings.soc)
        self.meter = Meter(
            world.physics, world.ground, charger, dt, soc, settings.temperature, settings.battery
        )
        self.recorder = Recorder(
            writer,
            names,
            world.track.network.edge_ids,
            settings.start,
            dt,
            every,
            self.steps,
            self.total,
            columns_of(bool(np.any(world.ground.z)), settings.battery is not None),
        )
        self.limits = limits_of(world.physics.actual_truck(), GAP)
        self.used = self.charged = self.waiting = 0.0

    def all(self, progress: Progress | None = None) -> Summary:
        """To the end."""
        total = self.total
        with self.recorder:
            for step0 in range(0, total, self.steps):
                self.batch(step0)
                if progress is not None:
                    progress((step0 + self.steps) * self.settings.step, total * self.settings.step)
            self.recorder.flush()
        self.events.close(total * self.settings.step)
        return self._summary(total)

    def batch(self, step0: int) -> None:
        """Some ten seconds of all trucks."""
        from fleetlog.simulate.kernels.traffic import advance

        dt, lift = self.settings.step, self.world.truck.lift
        self.dispatcher.soc = self.meter.soc
        bay = self.bay_of[self.fleet.door]
        for k in range(0, self.steps, self.second):
            self.dispatcher.tick((step0 + k) * dt)
            self.events.tick((step0 + k) * dt)
            advance(
                self.world.roads, self.fleet, self.limits, self.log, k, self.second, step0 + k, dt, lift.raise_speed,
                lift.lower_speed,
            )  # fmt: skip
        for first in range(0, len(self.names), TOGETHER):
            self._account(first, bay, step0)
        self.recorder.next()
        self._stop_empty()

    def _account(self, first: int, bay: NDArray[np.int32], step0: int) -> None:
        """Place, power and rows of some trucks over a batch."""
        which = slice(first, first + TOGETHER)
        log, dt = log_of(self.log, which), self.settings.step
        place = locate(self.world.ground, log)
        energy = self.meter.batch(log, place, bay[which], step0, first)
        self.used += float(np.maximum(energy.power, 0.0).sum()) * dt / 3600.0
        charging = np.where(log.mode == CHARGING, energy.power, 0.0)
        self.charged -= float(np.minimum(charging, 0.0).sum()) * dt / 3600.0
        slow = (log.v < STANDS) & IN_TRAFFIC[log.mode]
        self.waiting += float(slow.sum()) * dt
        self.recorder.add(first, log, place, energy)

    def _stop_empty(self) -> None:
        f = self.fleet
        for v in np.flatnonzero((self.meter.soc <= 0.0) & (f.mode != EMPTY)):
            if f.mode[v] in (PARKED, HANDLING, DRIVING, AT_BAY, WANTS_OUT) and not f.entry[v]:
                f.mode[v] = EMPTY
                f.asks[f.asks == v] = -1
                self.dispatcher.count.empty.append(self.names[v])

    def _summary(self, total: int) -> Summary:
        d = self.dispatcher
        notes = list(self.world.notes)
        if not (d.kind == "charge").any():
            notes.append("the site has no charger: nobody charges")
        open_tasks = d.count.tasks_given - d.count.tasks_done
        return Summary(
            len(self.names), total * self.settings.step, self.recorder.written, total * len(self.names), d.count,
            float(self.fleet.moved.sum()), self.used, self.charged, [float(s) for s in self.meter.soc], self.waiting,
            d.watch.longest,             open_tasks, notes,
        )  # fmt: skip


__all__ = ["Settings", "SiteError", "Summary", "simulate"]
