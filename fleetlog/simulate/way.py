"""A way that is driven once: its shape and where on the map it lies, node by node."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.simulate.paths import even, rounded, simplified

Floats = NDArray[np.float64]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class Way:
    """N nodes: ``distance`` [m] along, x, y, z [m], heading [rad], curvature [1/m], slope [rad], edge (-1 off the map), offset [m]."""

    distance: Floats
    x: Floats
    y: Floats
    z: Floats
    heading: Floats
    curvature: Floats
    slope: Floats
    edge: Index
    offset: Floats
    stops: tuple[int, ...] = ()

    def at(self, s: Floats, payload: float = 0.0) -> Motion:
        """Place and shape of the way at (M,) distances, as a motion with ``payload`` [kg]; the rest of it empty."""
        i = np.clip(np.searchsorted(self.distance, s, side="right") - 1, 0, len(self.distance) - 1)
        near = np.clip(
            np.rint(np.interp(s, self.distance, np.arange(len(self.distance)))).astype(int), 0, None
        )
        heading = np.interp(s, self.distance, np.unwrap(self.heading))
        offset = self.offset[i] + np.where(self.edge[i] >= 0, s - self.distance[i], 0.0)
        return Motion.of(
            len(s), x=np.interp(s, self.distance, self.x), y=np.interp(s, self.distance, self.y),
            heading=np.angle(np.exp(1j * heading)), curvature=np.interp(s, self.distance, self.curvature),
            slope=self.slope[near], edge=self.edge[i], edge_offset=offset, payload=payload,
        )  # fmt: skip


def joined(ways: list[Way], stop: bool) -> Way:
    """Ways one after the other, with or without a stop between them; their own stops are kept."""
    if len(ways) == 1:
        return ways[0]
    base = np.concatenate([[0.0], np.cumsum([w.distance[-1] + 1e-6 for w in ways])])
    begin = np.concatenate([[0], np.cumsum([len(w.distance) for w in ways])])[:-1]
    stops = [int(k + b) for w, b in zip(ways, begin, strict=True) for k in w.stops]
    stops += [int(b) for b in begin[1:]] if stop else []

    def join(name: str) -> Floats:
        return np.concatenate([np.asarray(getattr(w, name), dtype=np.float64) for w in ways])

    return Way(
        np.concatenate([w.distance + b for w, b in zip(ways, base[:-1], strict=True)]), join("x"), join("y"), join("z"),
        np.unwrap(join("heading")), join("curvature"), join("slope"), join("edge").astype(np.int32), join("offset"),
        tuple(sorted(stops)),
    )  # fmt: skip


def free_way(x: Floats, y: Floats, z: Floats, apart: float, radius: float) -> Way | None:
    """The way through (N,) positions off the roads, taken ``apart`` m from one another; None where it goes nowhere.

    Corners are rounded with ``radius`` [m]; slope is left out.
    """
    keep = [0]
    for i in range(1, len(x)):
        if np.hypot(x[i] - x[keep[-1]], y[i] - y[keep[-1]]) >= apart:
            keep.append(i)
    if len(keep) < 2:
        return None
    shape, length = even(rounded(simplified(np.column_stack([x, y])[keep]), radius), 1.0)
    n = len(shape)
    s = np.linspace(0.0, length, n)
    high = np.interp(s, np.linspace(0.0, length, len(keep)), z[keep])
    none = np.full(n, -1, np.int32)
    return Way(s, shape[:, 0], shape[:, 1], high, shape[:, 2], shape[:, 3], np.zeros(n), none, np.zeros(n))
