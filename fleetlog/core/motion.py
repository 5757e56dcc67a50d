"""The arrays that a physics term sees."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints


@dataclass(frozen=True)
class Motion:
    """N samples of motion; all arrays are (N,)."""

    time: Floats  # s since any origin, increasing
    dt: Floats  # s that each sample stands for (energy is sum(power * dt)); 0 where the log has a gap
    speed: Floats  # m/s along the path, >= 0
    acceleration: Floats  # m/s2 along the path
    slope: Floats  # rad along the motion, uphill positive; 0 where unknown
    curvature: Floats  # 1/m of the path, left positive
    heading: Floats  # rad, counter-clockwise from east
    payload: Floats  # kg
    lift_speed: Floats  # m/s, raising positive
    fork_height: Floats  # m
    x: Floats  # m in the site frame
    y: Floats
    edge: Index  # index into the network's edges, -1 off the map
    edge_offset: Floats  # m along the edge
    ambient_temperature: Floats  # degC, NaN unknown
    soc: Floats  # share, NaN unknown
    vehicle: Ints  # codes
    trip: Ints
    power: Floats  # measured at the battery [W], NaN where not measured

    @cached_property
    def looked_up(self) -> dict[object, tuple[Index, Floats]]:
        """Places looked up along it, and how they weigh, by a key of who did: kept as long as it is."""
        return {}

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, index: Any) -> "Motion":
        return Motion(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def replaced(self, **arrays: Any) -> "Motion":
        """A copy with some arrays exchanged."""
        return replace(self, **arrays)

    @classmethod
    def of(cls, n: int, **arrays: Any) -> "Motion":
        """``n`` samples with the given arrays or scalars; else at rest, level, unloaded, a second apart."""
        base: dict[str, Any] = {f.name: np.zeros(n) for f in fields(cls)}
        base.update(time=np.arange(n, dtype=float), dt=np.ones(n), edge=np.full(n, -1, np.int32))
        base.update(vehicle=np.zeros(n, np.int64), trip=np.zeros(n, np.int64))
        base.update({k: np.full(n, np.nan) for k in ("ambient_temperature", "soc", "power")})
        for name, value in arrays.items():
            base[name] = np.broadcast_to(np.asarray(value, dtype=base[name].dtype), (n,)).copy()
        return cls(**base)


def join(pieces: list[Motion]) -> Motion:
    """Pieces, one after the other."""
    return Motion(**{f.name: np.concatenate([getattr(p, f.name) for p in pieces]) for f in fields(Motion)})
