"""The arrays that a physics term sees."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """N samples of motion; all arrays are (N,) float64 unless said otherwise.

    Attributes
    ----------
    time : s since any origin, increasing.
    dt : s that each sample stands for (energy is ``sum(power * dt)``); 0 where the log has a gap.
    speed : m/s along the path, >= 0.
    acceleration : m/s2 along the path.
    slope : rad along the motion, uphill positive; 0 where unknown.
    curvature : 1/m of the path, left positive.
    heading : rad, counter-clockwise from east.
    payload : kg;  lift_speed : m/s, raising positive;  fork_height : m.
    x, y : m in the site frame.
    edge : int32 index into the network's edges, -1 off the map;  edge_offset : m along it.
    ambient_temperature : degC, NaN unknown.
    soc : share, NaN unknown.
    vehicle, trip : int64 codes.
    power : measured battery power [W], NaN where not measured.
    """

    time: Floats
    dt: Floats
    speed: Floats
    acceleration: Floats
    slope: Floats
    curvature: Floats
    heading: Floats
    payload: Floats
    lift_speed: Floats
    fork_height: Floats
    x: Floats
    y: Floats
    edge: NDArray[np.int32]
    edge_offset: Floats
    ambient_temperature: Floats
    soc: Floats
    vehicle: NDArray[np.int64]
    trip: NDArray[np.int64]
    power: Floats

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, index: Any) -> Motion:
        """The samples of a slice, mask or index array."""
        return Motion(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def replaced(self, **arrays: Any) -> Motion:
        """A copy with some arrays exchanged."""
        return replace(self, **arrays)

    @classmethod
    def of(cls, n: int, **arrays: Any) -> Motion:
        """``n`` samples with the given arrays or scalars; else at rest, level, unloaded, one second apart."""
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
