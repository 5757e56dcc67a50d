"""What an existing map lacks: roads that are driven and not in it, one-way roads driven against."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
NEAR = 3.0
"""A learned road within this of one of the map is that one [m]."""
ALIKE = np.cos(np.radians(45.0))
STEP = 1.0
SHORTEST = 5.0
"""A shorter stretch is no proposal [m]."""


@dataclass(frozen=True)
class Proposal:
    """A change of a map: the stretch ``begin`` to ``end`` [m] of a learned edge, and its evidence."""

    kind: Literal["missing road", "wrong one-way"]
    edge_id: str
    of_map: str
    begin: float
    end: float
    x: float
    y: float
    passes: int
    trucks: int
    days: int

    def line(self) -> str:
        """One sentence."""
        seen = f"{self.passes} passes of {self.trucks} trucks on {self.days} days"
        where = f"at ({self.x:.0f}, {self.y:.0f})"
        if self.kind == "wrong one-way":
            return f"{self.of_map} is one-way in the map and driven against it {where}: {seen}"
        return f"a road of {self.end - self.begin:.0f} m is missing {where} ({self.edge_id}): {seen}"


def proposals(learned: Network, evidence: pd.DataFrame, known: Network) -> list[Proposal]:
    """The stretches that ``known`` has not, or for the other direction only; those with most passes first."""
    from scipy.spatial import cKDTree

    edge, _, place, heading = _stations(known)
    found: list[Proposal] = []
    mine, offset, points, facing = _stations(learned)
    near = cKDTree(place).query_ball_point(points, NEAR)
    state, other = np.zeros(len(mine), np.int8), np.full(len(mine), -1)
    for i, beside in enumerate(near):
        turn = np.cos(heading[beside] - facing[i]) if beside else np.zeros(0)
        if not (turn > ALIKE).any():
            against = np.flatnonzero(turn < -ALIKE)
            state[i] = 2 if len(against) else 1
            other[i] = edge[beside[against[0]]] if len(against) else -1
    change = np.flatnonzero((np.diff(mine) != 0) | (np.diff(state) != 0)) + 1
    for a, b in pairwise([0, *change.tolist(), len(mine)]):
        if not state[a] or offset[b - 1] - offset[a] + STEP < SHORTEST:
            continue
        row, middle = evidence.iloc[int(mine[a])], (a + b) // 2
        wrong = state[a] == 2
        found.append(Proposal(
            "wrong one-way" if wrong else "missing road", learned.edge_ids[mine[a]],
            known.edge_ids[other[middle]] if wrong and other[middle] >= 0 else "",
            float(offset[a]), float(offset[b - 1]), float(points[middle, 0]), float(points[middle, 1]),
            int(row.passes), int(row.trucks), int(row.days),
        ))  # fmt: skip
    return sorted(found, key=lambda p: (-p.passes, p.edge_id, p.begin))


def _stations(n: Network) -> tuple[NDArray[np.int32], Floats, Floats, Floats]:
    """Edge, offset [m], place (N, 2) [m] and heading [rad] every metre of a network."""
    count = np.maximum(np.ceil(n.length / STEP).astype(int), 1)
    edge = np.repeat(np.arange(len(n), dtype=np.int32), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    offset = (step + 0.5) * (n.length / count)[edge]
    return edge, offset, n.position(edge, offset)[:, :2], n.heading(edge, offset)
