"""The rows of a vehicle-day as finely stepped motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.physics.motion import Reconstruction, reconstruct

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DAY = 86_400_000_000
"""Microseconds."""
TRIP = 1_000_000
"""Trip codes count on from this much of each vehicle."""


@dataclass(frozen=True)
class Block:
    """Rows of one vehicle on one day.

    Attributes
    ----------
    motion : (n,) samples;  row : (n,) the row that each belongs to, growing.
    time, seconds, power, soc : (rows,) stamp [s since the epoch], time it stands for [s], the recorded
    channels [W, 1].
    trip : (rows,) codes, unique over vehicles;  vehicle, day : codes.
    known : how well the motion is known.
    """

    motion: Motion
    row: Ints
    time: Floats
    seconds: Floats
    power: Floats
    soc: Floats
    trip: Ints
    vehicle: int
    day: int
    known: Reconstruction

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, values: Floats) -> Floats:
        """Return the mean of (n,) values over the samples of each row, (rows,)."""
        total = np.bincount(self.row, values * self.motion.dt, len(self))
        return np.asarray(total / np.maximum(self._weight, 1e-12))

    @cached_property
    def _weight(self) -> Floats:
        return np.asarray(np.bincount(self.row, self.motion.dt, len(self)), dtype=np.float64)

    @property
    def likeliest(self) -> Motion:
        """The motion with the likeliest accelerations, which those of ``motion`` lie above and below."""
        return self.motion.replaced(acceleration=self.known.likeliest.acceleration)

    @cached_property
    def first(self) -> Ints:
        """(rows,) the first sample of each row."""
        return np.minimum(np.searchsorted(self.row, np.arange(len(self))), len(self.motion) - 1)

    @cached_property
    def silent(self) -> NDArray[np.bool_]:
        """(rows,) whether the log was silent before a row."""
        m = self.motion
        gap = m.time[1:] - m.time[:-1] - 0.5 * (m.dt[1:] + m.dt[:-1]) > 1e-3
        out = np.zeros(len(self), bool)
        out[self.row[1:][gap]] = True
        return out


def block(
    trajectory: Trajectory, vehicle: int, network: Network | None, truck: Truck, *, lag: float = 0.0,
    scale: float = 1.0, load_lags: bool = False,
) -> Block:  # fmt: skip
    """Return one vehicle-day, its sensors put right by ``lag`` [s] and ``scale``."""
    r = reconstruct(trajectory, network, truck, lag, scale, load_lags=load_lags)
    time = np.asarray(trajectory.time * 1e-6, dtype=np.float64)
    motion = r.motion.replaced(
        time=r.motion.time + time[0],
        vehicle=np.broadcast_to(np.int64(vehicle), len(r.motion)),
        power=r.motion.power,
    )
    power = np.zeros(len(time))
    power[r.row] = motion.power
    return Block(
        motion, r.row, time, r.dt_row, power, trajectory.floats("soc"),
        trajectory.trip_ids() + TRIP * vehicle, vehicle, int(trajectory.time[0] // DAY), r,
    )  # fmt: skip
