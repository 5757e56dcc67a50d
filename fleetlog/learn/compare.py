"""What an existing map lacks: roads that are driven and not in it, one-way roads driven against."""

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fleetlog.core.network import Floats, Network

NEAR = 3.0  # a learned road within this of one of the map is that one [m]
ALIKE = np.cos(np.radians(45.0))
STEP = 1.0
SHORTEST = 5.0  # a shorter stretch is no proposal [m]


def proposals(learned: Network, evidence: pd.DataFrame, known: Network) -> list[dict[str, Any]]:
    """The stretches that ``known`` has not, or for the other direction only, those with most passes first.

    ``begin`` and ``end`` are offsets on a learned edge, ``x`` and ``y`` the middle of a stretch [m].
    """
    edge, _, place, heading = _stations(known)
    mine, offset, points, facing = _stations(learned)
    state, other = np.zeros(len(mine), np.int8), np.full(len(mine), -1)
    for i, beside in enumerate(cKDTree(place).query_ball_point(points, NEAR)):
        turn = np.cos(heading[beside] - facing[i]) if beside else np.zeros(0)
        if not (turn > ALIKE).any():
            against = np.flatnonzero(turn < -ALIKE)
            state[i] = 2 if len(against) else 1
            other[i] = edge[beside[against[0]]] if len(against) else -1
    found = []
    change = np.flatnonzero((np.diff(mine) != 0) | (np.diff(state) != 0)) + 1
    for a, b in pairwise([0, *change.tolist(), len(mine)]):
        if not state[a] or offset[b - 1] - offset[a] + STEP < SHORTEST:
            continue
        row, middle = evidence.iloc[int(mine[a])], (a + b) // 2
        against_it = state[a] == 2 and other[middle] >= 0
        found.append({
            "kind": "wrong one-way" if state[a] == 2 else "missing road",
            "edge_id": learned.edge_ids[mine[a]],
            "of_map": known.edge_ids[other[middle]] if against_it else "",
            "begin": float(offset[a]), "end": float(offset[b - 1]),
            "x": float(points[middle, 0]), "y": float(points[middle, 1]),
            **{name: int(row[name]) for name in ("passes", "trucks", "days")},
        })  # fmt: skip
    return sorted(found, key=lambda p: (-p["passes"], p["edge_id"], p["begin"]))


def sentence(proposal: dict[str, Any]) -> str:
    """A proposal for a person."""
    if proposal["kind"] == "wrong one-way":
        what = "{of_map} is one-way in the map and driven against it at ({x:.0f}, {y:.0f})"
    else:
        length = proposal["end"] - proposal["begin"]
        what = f"a road of {length:.0f} m is missing at ({{x:.0f}}, {{y:.0f}}) ({{edge_id}})"
    return (what + ": {passes} passes of {trucks} trucks on {days} days").format(**proposal)


def _stations(n: Network) -> tuple[NDArray[np.int32], Floats, Floats, Floats]:
    """Edge, offset [m], place (N, 2) [m] and heading [rad] every metre of a network."""
    count = np.maximum(np.ceil(n.length / STEP).astype(int), 1)
    edge = np.repeat(np.arange(len(n), dtype=np.int32), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    offset = (step + 0.5) * (n.length / count)[edge]
    return edge, offset, n.position(edge, offset)[:, :2], n.heading(edge, offset)
