"""One truck by itself: its recorded trips, driven again as the model would, or a test cycle."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.motion import Motion
from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError, InputError, nearest
from fleetlog.physics.battery import CHARGING
from fleetlog.physics.cycles import CYCLES, VDI_LEGS
from fleetlog.physics.motion import measured_channels, reconstruct
from fleetlog.physics.motion.channels import forks
from fleetlog.physics.motion.legs import Leg, SpeedProfile, free_flow, joined, legs, speed_limits
from fleetlog.physics.power import Physics, battery_power, soc_change
from fleetlog.simulate.places import MIN_CHARGE
from fleetlog.simulate.record import rounded
from fleetlog.simulate.state import creep_speed
from fleetlog.store.dataset import Dataset
from fleetlog.store.trips import MAX_GAP
from fleetlog.store.writer import DatasetWriter

FINE = 0.1  # Length of the steps that power is worked out in [s]
MOST = 100_000_000  # Rows of one truck between two of its trips
ROUNDED = 9  # Nodes over which a truck goes from one lane over to the next


@dataclass
class Trip:
    """A recorded trip: rows, when it left and arrived [s since the first row], leg and speeds. It is driven
    from ``begin`` on, or when the one before is done; not before ``earliest``, when what the truck did before
    without driving is done. ``work`` [s] after the arrival loads and forks come to rest."""

    number: int
    rows: Trajectory
    leave: float
    arrive: float
    leg: Leg | None
    drive: SpeedProfile | None
    payload: float
    begin: float
    work: float
    earliest: float = -np.inf


class VehicleReplay:
    """One truck's recording, driven again."""

    def __init__(
        self, recorded: Trajectory, dataset: Dataset, truck: Truck, physics: Physics, writer: DatasetWriter,
        lanes: Floats, temperature: float,
    ) -> None:  # fmt: skip
        self.recorded, self.site, self.writer = recorded, dataset.site, writer
        self.physics = physics.of(recorded.vehicle_id, recorded.time[0] * 1e-6)
        found = reconstruct(measured_channels(recorded, dataset.meta), self.site.network, truck)
        self.temperature = temperature  # Where the log has none [degC]
        self.lanes = lanes  # (E,) metres that trucks keep to the left of the middle of their roads
        self.energy = found.rows(np.nan_to_num(found.motion.power) * found.motion.dt)
        self.legs: dict[int, list[Leg]] = {}
        for leg in legs(found):
            self.legs.setdefault(leg.trip, []).append(leg)
        self.time, self.mast = recorded.seconds(), forks(recorded.seconds(), recorded)
        self.interval = max(round(float(np.median(np.diff(self.time))) / FINE), 1) * FINE
        self.totals, self.written = np.zeros(6), 0
        soc = recorded.floats("soc")
        known = soc[np.isfinite(soc)]
        self.soc = float(known[0]) if len(known) else 0.95
        self.place: Leg | None = None
        ids = recorded.trip_ids()
        begins = np.concatenate([[0], np.flatnonzero(np.diff(ids)) + 1, [len(ids)]])
        self.trips = [self._trip(int(ids[a]), int(a), int(b)) for a, b in itertools.pairwise(begins)]
        stands = -np.inf
        for trip in self.trips:
            trip.earliest = max(trip.begin, stands)
            stands = max(stands, trip.begin + trip.work) if trip.leg is None else -np.inf

    def run(self) -> None:
        """All trips in order of time."""
        clock, row = 0.0, 0
        for k, trip in enumerate(self.trips):
            leave = max(trip.begin, clock)
            arrival = leave + (trip.drive.duration if trip.drive is not None else 0.0)
            ready = arrival + trip.work
            last = k + 1 == len(self.trips)
            until = max(ready, float(self.time[-1])) if last else max(ready, self.trips[k + 1].begin)
            end = int(np.ceil((until - 1e-9) / self.interval)) + (1 if last else 0)
            if end - row > MOST:
                what = f"a truck stands for {(end - row) * self.interval / 86400.0:,.0f} days"
                raise DataError(what, place=f"trip {trip.number}", do="take out the rows with a wrong time")
            self._write(trip, leave, arrival, np.arange(row, max(end, row), dtype=np.float64) * self.interval)
            clock, row = until, max(end, row)

    def _trip(self, number: int, a: int, b: int) -> Trip:
        from scipy.ndimage import uniform_filter1d

        rows, driven = self.recorded[a:b], self.legs.get(number)
        if not driven:
            at = float(self.time[a])
            return Trip(number, rows, at, at, None, None, 0.0, at, self._work(rows, at))
        leg, network = joined(driven), self.site.network
        if network is not None:
            # On the middle of its roads, where it lies on roads.
            p, on = leg.path, leg.path.edge >= 0
            x, y, _ = network.position(np.maximum(p.edge, 0), p.edge_offset).T
            leg = replace(leg, path=p.replaced(x=np.where(on, x, p.x), y=np.where(on, y, p.y)))
        self.totals[:3] += leg.distance[-1], leg.duration, self.energy[a:b].sum()
        leave, arrive = float(leg.path.time[0]), float(leg.path.time[-1])
        payload, work = float(np.median(leg.path.payload)), self._work(rows, arrive)
        # Beside the middle of its roads, without a jump at corners.
        p, drive = leg.path, self.free_flow(leg)
        left = uniform_filter1d(np.where(p.edge >= 0, self.lanes[p.edge], 0.0), ROUNDED, mode="nearest")
        beside = p.replaced(x=p.x - left * np.sin(p.heading), y=p.y + left * np.cos(p.heading))
        return Trip(number, rows, leave, arrive, replace(leg, path=beside), drive, payload, leave, work)

    def free_flow(self, leg: Leg) -> SpeedProfile:
        """Speeds on a leg; into a bay and out of it a truck creeps."""
        limit, off = speed_limits(self.site, leg.path), leg.path.edge < 0
        slow = np.minimum(limit, creep_speed(self.physics.actual_truck))
        return free_flow(leg, self.physics.at(leg.path.time[0]), np.where(off & (not off.all()), slow, limit))

    def _work(self, rows: Trajectory, arrive: float) -> float:
        """Seconds after the arrival until loads and forks have come to rest."""
        time = (rows.time - self.recorded.time[0]) * 1e-6 - arrive
        busy = np.zeros(len(time), dtype=bool)
        for name in ("payload", "fork_height"):
            busy[1:] |= np.abs(np.diff(np.nan_to_num(rows.floats(name)))) > 0.02
        return float(np.max(time[busy & (time >= 0.0)], initial=0.0))

    def _write(self, trip: Trip, leave: float, arrival: float, rows: Floats) -> None:
        # Near a recorded row, or on the way: where the log was silent overnight, so is the replay.
        k = np.clip(np.searchsorted(self.time, rows), 1, len(self.time) - 1)
        near = np.minimum(np.abs(rows - self.time[k - 1]), np.abs(rows - self.time[k])) <= MAX_GAP / 2.0
        if not len(rows := rows[near | ((rows >= leave) & (rows <= arrival))]):
            return
        steps = max(round(self.interval / FINE), 1)
        fine = (rows[:, None] + ((np.arange(steps) + 0.5) / steps - 0.5) * self.interval).ravel()
        motion = self._motion(trip, fine, leave, arrival)
        power = battery_power(motion, self.physics)
        # What a standing truck is charged with is taken over as recorded.
        power = np.where((motion.power < CHARGING) & (motion.speed == 0.0), motion.power, power)
        dt, truck = np.full(len(fine), self.interval / steps), self.physics.at(fine[0]).actual_truck
        change = soc_change(power, dt, truck).reshape(-1, steps).sum(axis=1)
        soc = np.clip(self.soc + np.cumsum(np.append(0.0, change)), 0.0, 1.0)
        self.soc, soc = float(soc[-1]), soc[:-1]
        mean = power.reshape(-1, steps).mean(axis=1)
        self._emit(trip, rows, self._motion(trip, rows, leave, arrival), mean, soc)
        if trip.leg is not None:
            assert trip.drive is not None
            # Energy is compared only where it was measured.
            joules = float(mean.sum() * self.interval) if trip.rows.has("battery_power") else 0.0
            self.totals[3:] += trip.leg.distance[-1], trip.drive.duration, joules

    def _motion(self, trip: Trip, time: Floats, leave: float, arrival: float) -> Motion:
        s, v, a = np.zeros((3, len(time)))
        if trip.leg is not None and trip.drive is not None:
            s, v, a = trip.drive.at(time - leave)
            self.place = trip.leg
        elif self.place is not None:
            s = s + self.place.distance[-1]
        dt = self.interval if len(time) < 2 else float(time[1] - time[0])
        if self.place is None:
            at = Motion.of(len(time), x=self._along("x", time), y=self._along("y", time))
        else:
            at = self.place.at(s)
        return at.replaced(
            time=time, dt=np.full(len(time), dt), speed=v, acceleration=a, soc=np.full(len(time), self.soc),
            ambient_temperature=np.nan_to_num(self._along("ambient_temperature", time), nan=self.temperature),
            **self._doing(trip, time, dt, leave, arrival),
        )  # fmt: skip

    def _along(self, name: str, time: Floats) -> Floats:
        values = self.recorded.floats(name)
        good = np.isfinite(values)
        return np.interp(time, self.time[good], values[good]) if good.any() else np.full(len(time), np.nan)

    def _doing(self, trip: Trip, time: Floats, dt: float, leave: float, arrival: float) -> dict[str, Floats]:
        """Forks, load (on the way the trip's) and recorded power, as after the arrival."""
        shift = np.where(time < leave, time - leave + trip.leave, time - arrival + trip.arrive)
        known = (trip.rows.time - self.recorded.time[0]) * 1e-6
        near = np.clip(np.searchsorted(known, shift), 0, len(known) - 1)
        inside = (shift >= known[0]) & (shift < known[-1])
        shift = np.clip(shift, known[0], known[-1])
        lift = np.where(inside, self.mast.speed(shift - 0.5 * dt, np.full(len(shift), dt)), 0.0)
        payload = np.nan_to_num(trip.rows.floats("payload"))[near]
        capacity = self.physics.actual_truck.battery.capacity_wh
        power = np.where(inside, charging_power(trip.rows, capacity)[near], 0.0)
        way = (time >= leave) & (time < arrival)
        return {
            "fork_height": np.where(way, 0.0, self.mast.at(shift)), "lift_speed": np.where(way, 0.0, lift),
            "payload": np.where(way, trip.payload, payload), "power": np.where(way, 0.0, power),
        }  # fmt: skip

    def _emit(self, trip: Trip, rows: Floats, at: Motion, power: Floats, soc: Floats) -> None:
        # Loads and forks are those of the recording: what it does not know is not known here.
        own = {name: getattr(at, name) for name in ("payload", "fork_height") if self.recorded.has(name)}
        columns = rounded({
            "x": at.x, "y": at.y, "heading": at.heading, "speed": at.speed, "battery_power": power,
            "soc": soc, **own,
        })  # fmt: skip
        columns["trip_id"] = np.full(len(rows), trip.number, np.int64)
        if self.recorded.has("ambient_temperature"):
            columns["ambient_temperature"] = np.round(at.ambient_temperature, 2)
        if self.site.network is not None and (at.edge >= 0).any():
            used, names = np.unique(at.edge[at.edge >= 0]), self.site.network.edge_ids
            off = at.edge < 0
            codes = np.where(off, -1, np.searchsorted(used, at.edge)).astype(np.int32)
            columns["edge_id"] = Labels(codes, tuple(names[i] for i in used))
            length = self.site.network.length[np.maximum(at.edge, 0)]
            columns["edge_offset"] = np.where(off, np.nan, np.round(np.clip(at.edge_offset, 0.0, length), 3))
            columns["lateral_offset"] = np.where(off, np.nan, self.lanes[at.edge])
        time = self.recorded.time[0] + np.rint(rows * 1e6).astype(np.int64)
        self.writer.write(Trajectory(self.recorded.vehicle_id, time, columns))
        self.written += len(rows)


def charging_power(rows: Trajectory, capacity_wh: float) -> Floats:
    """(N,) recorded power [W]; without it what raised the state of charge from its lowest, 0 elsewhere."""
    out, known = np.nan_to_num(rows.floats("battery_power")), np.flatnonzero(np.isfinite(rows.floats("soc")))
    if rows.has("battery_power") or not len(known):
        return out
    soc = rows.floats("soc")
    low = known[soc[known].argmin()]
    high = low + np.nan_to_num(soc[low:]).argmax()
    if (rise := soc[high] - soc[low]) > MIN_CHARGE:
        out[low:high] = -rise * capacity_wh * 3600.0 / ((rows.time[high] - rows.time[low]) * 1e-6)
    return out


def strip() -> Site:
    """Thirty metres of two-way floor."""
    points = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    edge = Edge("strip", "a", "b", points, "strip", width=4.0)
    return Site("test strip", network=build_network([edge, reversed_edge(edge)]))


def run_cycle(
    name: str, truck: Truck, duration: float, writer: DatasetWriter, physics: Physics, start: int, soc: float
) -> float:
    """Write ``duration`` [s] of a cycle, to and fro on the strip, at 10 Hz; the energy of an hour [Wh]."""
    if name not in CYCLES:
        raise InputError(f"unknown cycle {name!r}", do=nearest(name, CYCLES))
    one, every = CYCLES[name](truck), 0.1
    period, ends = float(one.dt.sum()), np.concatenate([[0.0], np.cumsum(one.dt)])
    energy = np.concatenate([[0.0], np.cumsum(battery_power(one, physics.fleet) * one.dt)])
    at = np.arange(0.0, duration, every)
    k = np.clip(np.searchsorted(ends[1:], at % period, side="right"), 0, len(one) - 1)
    driven, turn = np.cumsum(one.speed * one.dt)[k], sum(VDI_LEGS[:2])
    back = driven - 1e-9 >= turn
    x = np.where(back, np.maximum(2.0 * turn - driven, 0.0), driven)

    def used(time: Floats) -> Floats:
        whole = np.floor(time / period + 1e-12)
        return np.asarray(whole * energy[-1] + np.interp(time - whole * period, ends, energy))

    mean = (used(at + every) - used(at)) / every
    change = soc_change(mean, np.full(len(at), every), physics.actual_truck)
    columns = rounded({
        "x": x, "heading": np.where(back, np.pi, 0.0), "speed": one.speed[k], "battery_power": mean,
        "edge_offset": np.where(back, 30.0 - x, x),
        "fork_height": np.cumsum(one.lift_speed * one.dt)[k] + 0.3,
        "soc": np.clip(soc + np.concatenate([[0.0], np.cumsum(change)[:-1]]), 0.0, 1.0),
    }) | {
        "y": np.zeros(len(at)), "lateral_offset": np.zeros(len(at)), "payload": one.payload[k],
        "edge_id": Labels(back.astype(np.int32), ("strip", "-strip")),
        "trip_id": np.floor(at / period + 1e-12).astype(np.int64),
    }  # fmt: skip
    writer.write(Trajectory("T1", start + np.rint(at * 1e6).astype(np.int64), columns))
    return float(energy[-1] / period)
