"""From steps to power and charge, and to rows of the dataset, written by threads as the fleet drives on."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index
from fleetlog.core.motion import Motion
from fleetlog.core.trajectory import Labels, Trajectory, Values
from fleetlog.core.truck import Truck
from fleetlog.physics.battery import discharge
from fleetlog.physics.power import battery_power, cell_power
from fleetlog.simulate.state import Log, Mode, Modes
from fleetlog.simulate.track import Track
from fleetlog.store.writer import DatasetWriter

if TYPE_CHECKING:
    from fleetlog.simulate.engine import Settings
    from fleetlog.simulate.world import World

CHARGE_RATE = 0.25  # Power of a charger that the site does not state, in battery capacities an hour
TAPER_FROM = 0.8  # State of charge from which charging power falls, to a tenth when full: constant voltage
ROWS = 8_000_000  # Rows that are kept at most before they are written; some 60 bytes each
DIGITS = {  # Decimals that are written, so that files are small; rows wait as whole numbers of them
    "x": 3, "y": 3, "z": 3, "heading": 5, "speed": 4, "edge_offset": 3, "lateral_offset": 3, "payload": 1,
    "fork_height": 3, "battery_power": 2, "battery_voltage": 3, "battery_current": 3, "soc": 8,
}  # fmt: skip
MEANS = ("battery_power", "battery_voltage", "battery_current")
"""Columns of which a row has the mean over the time around it."""
NULL = int(np.iinfo(np.int32).min)
TOGETHER = 16  # Trucks that are written at once, where there are as many
BEHIND = 8  # Such groups that may wait to be written; the fleet waits when there are more
Columns = dict[str, NDArray[Any]]  # (V, K) of a batch, by name


def locate(ground: Track, log: Log) -> Columns:
    """Where on the map every logged state is."""
    from fleetlog.simulate.kernels.geometry import expand

    t, back = ground, (log.mode == Mode.LEAVING).ravel()
    out, edge = np.empty((8, log.piece.size)), np.empty(log.piece.size, np.int32)
    expand(log.piece.ravel(), log.s.ravel(), back, t.first, t.spacing, t.samples, t.edge, out, edge)
    names = ("x", "y", "z", "heading", "curvature", "slope", "edge_offset", "lateral_offset", "edge")
    return {n: values.reshape(log.piece.shape) for n, values in zip(names, [*out, edge], strict=True)}


class Meter:
    """Follows the charge of trucks (V,), and sums up the energy charged, and used less recovered [Wh]."""

    def __init__(self, world: "World", settings: "Settings") -> None:
        self.physics, self.of, self.limit = world.physics, world.trucks.of, world.site.power_limit
        self.dt, self.temperature, self.battery = settings.step, settings.temperature, settings.battery
        places = [bay.place for bay in world.bays]
        power = [p.power if np.isnan(p.swap) else 0.0 for p in places]  # Swapped batteries are not charged
        self.charger = np.where([p.kind == "charge" for p in places], power, np.nan)
        self.soc = np.full(len(self.of), settings.soc)
        self.share = 1.0  # Of its power that each charger gives now
        self.moved = np.full(len(self.of), -1e9)  # (V,) when each truck last moved [s]
        self.used = self.charged = 0.0

    def share_site_power(self, mode: Modes, bay: Index) -> None:
        """What each charger may give of its power, so that all together keep to the limit of the site."""
        charging = np.flatnonzero(mode == Mode.CHARGING)
        wanted = sum(float(self._charge_power(bay[v : v + 1], slice(v, v + 1))[0]) for v in charging.tolist())
        self.share = min(1.0, self.limit / wanted) if wanted > 0.0 else 1.0

    def batch(self, log: Log, place: Columns, bay: Index, step0: int, which: slice) -> Columns:
        """Power and charge of ``which`` trucks, of one kind, from step ``step0``; ``bay`` (V,) of each."""
        trucks, steps = log.piece.shape
        n, first, physics = trucks * steps, which.start, self.physics[self.of[which.start]]
        time, speed = (step0 + np.arange(steps)) * self.dt, np.maximum(log.v + 0.5 * log.a * self.dt, 0.0)
        motion = Motion(
            time=np.tile(time, trucks), dt=np.full(n, self.dt), speed=speed.ravel(),
            acceleration=log.a.ravel(), payload=log.load.ravel(), lift_speed=log.lift.ravel(),
            fork_height=log.height.ravel(), ambient_temperature=np.full(n, self.temperature),
            soc=np.repeat(self.soc[which], steps), vehicle=np.repeat(np.arange(first, first + trucks), steps),
            trip=log.trip.ravel().astype(np.int64), power=np.zeros(n),
            **{name: place[name].ravel() for name in place.keys() - {"z", "lateral_offset"}},
        )  # fmt: skip
        if physics.values:
            # Terms may look back: before its first moment each truck has that in which it last moved.
            motion = motion[np.repeat(np.arange(n), np.where(np.arange(n) % steps, 1, 2))]
            motion.time[:: steps + 1], motion.speed[:: steps + 1] = self.moved[which], 1.0
            self.moved[which] = np.where(speed > 0.0, time, self.moved[which, None]).max(axis=1)
        power = battery_power(motion, physics).reshape(trucks, -1)[:, -steps:]
        if (charging := log.mode == Mode.CHARGING).any():
            power = power - np.where(charging, self.share * self._charge_power(bay, which)[:, None], 0.0)
        power[log.mode == Mode.EMPTY] = 0.0
        self.used += float(power[~charging].sum()) * self.dt / 3600.0
        self.charged -= float(np.minimum(np.where(charging, power, 0.0), 0.0).sum()) * self.dt / 3600.0
        return {"battery_power": power, **self._state(power, which, physics.at(step0 * self.dt).actual_truck)}

    def _charge_power(self, bay: Index, which: slice) -> Floats:
        rate, battery = self.charger[bay], self.physics[self.of[which.start]].truck.battery
        rate = np.where(np.isfinite(rate), rate, CHARGE_RATE * battery.capacity_wh)
        taper = 1.0 - 0.9 * np.clip((self.soc[which] - TAPER_FROM) / (1.0 - TAPER_FROM), 0.0, 1.0)
        return np.asarray(rate * taper)

    def _state(self, power: Floats, which: slice, truck: Truck) -> Columns:
        """The charge at the start of each step; by a battery's chemistry also voltage [V] and current [A]."""
        charge = self.soc[which]
        if self.battery is None:
            soc = np.zeros((len(power), power.shape[1] + 1))
            np.cumsum(cell_power(power, truck), axis=1, out=soc[:, 1:])
            soc *= -self.dt / (3600.0 * truck.battery.capacity_wh)
            soc += charge[:, None]
            np.clip(soc, 0.0, 1.0, out=soc)
            charge[:] = soc[:, -1]
            return {"soc": np.ascontiguousarray(soc[:, :-1])}
        (soc, volts, amps), dt = np.empty((3, *power.shape)), np.full(power.shape[1], self.dt)
        for v in range(len(power)):
            d = discharge(power[v], dt, self.battery, float(charge[v]), self.temperature)
            soc[v, 0], soc[v, 1:] = charge[v], d.soc[:-1]
            volts[v], amps[v], charge[v] = d.voltage, d.current, d.soc[-1]
        return {"soc": soc, "battery_voltage": volts, "battery_current": amps}


class Recorder:
    """Takes batches of ``steps`` steps, keeps every ``every``-th one as a row, and writes a group of trucks'
    rows when enough have come together, or the ``total`` of steps is reached.

    Height is known of hilly sites, voltage and current by a battery's chemistry.  Power of a row is the mean
    over the ``every`` steps around it, so that power times the time between rows adds up to the energy.
    Groups are written in turn, each by one thread at a time: the same bytes whatever the number of threads.
    Leaving the block without :meth:`flush` gives up what is not written."""

    def __init__(
        self, writer: DatasetWriter, names: list[str], world: "World", settings: "Settings", steps: int,
        total: int,
    ) -> None:  # fmt: skip
        self.writer, self.names, self.edges = writer, names, world.track.network.edge_ids
        flat, nominal = not np.any(world.ground.z), settings.battery is None
        unknown = ("z",) * flat + MEANS[1:] * nominal
        self.columns = tuple(c for c in DIGITS if c not in unknown)
        every, dt = round(settings.interval / settings.step), round(settings.step * 1e6)
        self.every, self.interval, self.start = every, every * dt, settings.start + every // 2 * dt
        trucks, batches = len(names), total // steps
        groups = -(-trucks // min(TOGETHER, trucks))
        self._most = min(max(ROWS * every // (trucks * steps), 1), batches)
        # Groups become due one after the other, the first when its rows are half of the most that are kept;
        # where all rows can be kept, all at the end.
        share = 1.0 if self._most == batches else 0.5 + 0.5 * (np.arange(groups) + 1) / (groups + 1)
        self._due = np.full(groups, np.maximum(share * self._most, 1.0)).astype(int)
        self._batch = np.zeros((trucks, len(self.columns) + 2, steps // every), np.int32)
        self._rows = np.zeros(groups, np.int64)
        self._kept: list[list[Index]] = [[] for _ in range(groups)]
        self._pool = ThreadPoolExecutor(min(os.cpu_count() or 1, 4))
        self._jobs: dict[int, Future[None]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def add(self, trucks: slice, log: Log, found: Columns) -> None:
        """One batch of some trucks; :meth:`next` when it was added for all of them."""
        known = {**found, "speed": log.v, "payload": log.load, "fork_height": log.height}
        batch, middle = self._batch[trucks], self.every // 2
        for k, name in enumerate(self.columns):
            values = known[name]
            if name in MEANS:
                rows = sum(values[:, i :: self.every] for i in range(self.every)) / self.every
            else:
                rows = values[:, middle :: self.every]
            batch[:, k] = np.nan_to_num(np.rint(rows * 10.0 ** DIGITS[name]), nan=NULL)
        batch[:, -2], batch[:, -1] = (codes[:, middle :: self.every] for codes in (found["edge"], log.trip))

    def next(self) -> None:
        """All trucks have had their batch: groups that are due are written."""
        for group, kept in enumerate(self._kept):
            kept.append(self._batch[group * TOGETHER : (group + 1) * TOGETHER].copy())
            if len(kept) >= self._due[group]:
                self._hand_over(group)
                self._due[group] = self._most

    def flush(self) -> None:
        """Write all that is left, and wait for it."""
        for group, kept in enumerate(self._kept):
            if kept:
                self._hand_over(group)
        for job in self._jobs.values():
            job.result()

    def _hand_over(self, group: int) -> None:
        """Let the rows of a group be written, after those handed over earlier."""
        while group in self._jobs or len(self._jobs) >= BEHIND:
            self._jobs.pop(group if group in self._jobs else next(iter(self._jobs))).result()
        rows = np.concatenate(self._kept[group], axis=2)
        self._jobs[group] = self._pool.submit(self._write, group, rows, int(self._rows[group]))
        self._rows[group] += rows.shape[2]
        self._kept[group].clear()

    def _write(self, group: int, whole: Index, before: int) -> None:
        """(trucks, columns, rows) of a group that has so many rows ``before``."""
        trucks, _, rows = whole.shape
        columns: dict[str, Values] = {}
        for k, name in enumerate(self.columns):
            codes = whole[:, k].ravel()
            columns[name] = np.where(codes == NULL, np.nan, codes / 10.0 ** DIGITS[name])
        # Only the names of edges that occur: dictionaries stay small.
        used, edge = np.unique(whole[:, -2], return_inverse=True)
        columns["edge_id"] = Labels(edge.ravel().astype(np.int32), tuple(self.edges[i] for i in used))
        columns["trip_id"] = whole[:, -1].ravel().astype(np.int64)
        time = np.tile(self.start + (before + np.arange(rows)) * self.interval, trucks)
        names = self.names[group * TOGETHER :][:trucks]
        self.writer.write_together(names, Trajectory(names[0], time, columns))


def rounded(columns: dict[str, Floats]) -> dict[str, Values]:
    """Columns to the decimals that a simulation writes; headings from -pi to pi."""
    if "heading" in columns:
        columns = {**columns, "heading": np.remainder(columns["heading"] + np.pi, 2.0 * np.pi) - np.pi}
    return {name: np.round(values, DIGITS[name]) for name, values in columns.items()}
