"""Whom and when a number concerns: the fleet, some vehicles, the time since a change, or a drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.physics.own import share


@dataclass(frozen=True, order=True)
class Scope:
    """``vehicles``: codes, none for all; from ``begin`` to ``until`` [s since 1970], or growing over that."""

    vehicles: tuple[int, ...] = ()
    begin: float = -np.inf
    until: float = np.inf
    drift: bool = False

    @property
    def whole(self) -> bool:
        """Whether it is the fleet, always."""
        return self == FLEET

    @property
    def timed(self) -> bool:
        """Whether it is a part of the time only."""
        return bool(np.isfinite(self.begin) or np.isfinite(self.until))

    @property
    def one(self) -> int | None:
        """The one vehicle that it is, always; its columns are the fleet's, in the rows of the vehicle."""
        return self.vehicles[0] if len(self.vehicles) == 1 and not self.timed else None

    def covers(self, vehicle: int) -> bool:
        """Return whether a vehicle belongs to it."""
        return not self.vehicles or vehicle in self.vehicles

    def share(self, vehicle: int, time: Floats) -> Floats:
        """Return how far it holds for a vehicle at some times, (N,): 0 to 1."""
        if not self.covers(vehicle):
            return np.zeros(len(time))
        return share(time, self.begin, self.until, self.drift)


FLEET = Scope()
