"""Power and charge of all trucks over a batch of steps, by the one list of terms."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.battery import BatteryModel, discharge
from fleetlog.physics.power import Physics, battery_power, cell_power
from fleetlog.simulate.arrays import Floats, Index, Modes
from fleetlog.simulate.state import Log, Mode
from fleetlog.simulate.track import Track

CHARGE_RATE = 0.25
"""Power of a charger that the site does not state, in battery capacities an hour."""
TAPER_FROM = 0.8
"""State of charge from which charging power falls, to a tenth when full: then voltage is constant."""


class Energy(NamedTuple):
    """(V, K) battery power [W], charge at the start of each step, voltage [V], current [A] or None."""

    power: Floats
    soc: Floats
    voltage: Floats | None
    current: Floats | None


class Batch(NamedTuple):
    """(V, K) of a batch beside the log: place on the map."""

    x: Floats
    y: Floats
    z: Floats
    heading: Floats
    curvature: Floats
    slope: Floats
    offset: Floats
    lateral: Floats
    edge: Index


def locate(ground: Track, log: Log) -> Batch:
    """Where on the map every logged state is."""
    from fleetlog.simulate.kernels.geometry import expand

    t, shape = ground, log.piece.shape
    out, edge = expand(
        log.piece.ravel(), log.s.ravel(), (log.mode == Mode.LEAVING).ravel(), t.first, t.spacing, t.x, t.y,
        t.z, t.heading, t.curvature, t.slope, t.edge, t.offset, t.lateral,
    )  # fmt: skip
    return Batch._make([*out.reshape(-1, *shape), edge.reshape(shape)])


@dataclass
class Meter:
    """Follows the charge of trucks; no ``battery``: nominal.

    ``physics`` of each kind, ``of`` (V,) the kind of each truck; ``charger`` (B,) [W] of bays, NaN: none;
    ``limit`` [W] of all chargers together.
    """

    physics: list[Physics]
    of: Index
    ground: Track
    charger: Floats
    dt: float
    soc: Floats
    temperature: float = 20.0
    battery: BatteryModel | None = None
    limit: float = np.inf
    share: float = 1.0
    """Of its power that each charger gives now."""

    def share_site_power(self, mode: Modes, bay: Index) -> None:
        """What each charger may give of its power, so that all together keep to the limit of the site."""
        charging = np.flatnonzero(mode == Mode.CHARGING)
        wanted = sum(float(self._charge_power(bay[v : v + 1], slice(v, v + 1))[0]) for v in charging.tolist())
        self.share = min(1.0, self.limit / wanted) if wanted > 0.0 else 1.0

    def batch(self, log: Log, place: Batch, bay: Index, step0: int, which: slice) -> Energy:
        """Power and charge of ``which`` trucks, of one kind, from step ``step0``; ``bay`` (V,) of each."""
        trucks, steps = log.piece.shape
        n, first, physics = trucks * steps, which.start, self.physics[self.of[which.start]]
        motion = Motion(
            time=np.tile((step0 + np.arange(steps)) * self.dt, trucks), dt=np.full(n, self.dt),
            speed=np.maximum(log.v + 0.5 * log.a * self.dt, 0.0).ravel(), acceleration=log.a.ravel(),
            slope=place.slope.ravel(), curvature=place.curvature.ravel(), heading=place.heading.ravel(),
            payload=log.load.ravel(), lift_speed=log.lift.ravel(), fork_height=log.height.ravel(),
            x=place.x.ravel(), y=place.y.ravel(), edge=place.edge.ravel(), edge_offset=place.offset.ravel(),
            ambient_temperature=np.full(n, self.temperature), soc=np.repeat(self.soc[which], steps),
            vehicle=np.repeat(np.arange(first, first + trucks), steps),
            trip=log.trip.ravel().astype(np.int64), power=np.zeros(n),
        )  # fmt: skip
        power = battery_power(motion, physics).reshape(trucks, steps)
        charging = log.mode == Mode.CHARGING
        if charging.any():
            power = power - np.where(charging, self.share * self._charge_power(bay, which)[:, None], 0.0)
        power[log.mode == Mode.EMPTY] = 0.0
        return self._follow(power, which)

    def _charge_power(self, bay: Index, which: slice) -> Floats:
        truck = self.physics[self.of[which.start]].truck
        rate = self.charger[bay]
        rate = np.where(np.isfinite(rate), rate, CHARGE_RATE * truck.battery.capacity_wh)
        taper = 1.0 - 0.9 * np.clip((self.soc[which] - TAPER_FROM) / (1.0 - TAPER_FROM), 0.0, 1.0)
        return np.asarray(rate * taper)

    def _follow(self, power: Floats, which: slice) -> Energy:
        truck: Truck = self.physics[self.of[which.start]].actual_truck()
        if self.battery is not None:
            return self._chemistry(power, which)
        soc = np.zeros((len(power), power.shape[1] + 1))
        np.cumsum(cell_power(power, truck), axis=1, out=soc[:, 1:])
        soc *= -self.dt / (3600.0 * truck.battery.capacity_wh)
        soc += self.soc[which, None]
        np.clip(soc, 0.0, 1.0, out=soc)
        self.soc[which] = soc[:, -1]
        return Energy(power, np.ascontiguousarray(soc[:, :-1]), None, None)

    def _chemistry(self, power: Floats, which: slice) -> Energy:
        assert self.battery is not None
        soc, volts, amps = np.empty_like(power), np.empty_like(power), np.empty_like(power)
        dt = np.full(power.shape[1], self.dt)
        charge = self.soc[which]
        for v in range(len(power)):
            d = discharge(power[v], dt, self.battery, float(charge[v]), self.temperature)
            soc[v, 0], soc[v, 1:] = charge[v], d.soc[:-1]
            volts[v], amps[v], charge[v] = d.voltage, d.current, d.soc[-1]
        return Energy(power, soc, volts, amps)
