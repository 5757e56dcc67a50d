"""What an existing map lacks: roads that are driven and not in it, one-way roads driven against."""

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from fleetlog.core.network import Network

NEAR = 3.0  # a learned road within this of one of the map is that one [m]
ALIKE = np.cos(np.radians(45.0))
STEP = 1.0
SHORTEST = 5.0  # a shorter stretch is no proposal [m]
SAME, NONE = -2, -1  # where the map has the road, and where it has none


def proposals(learned: Network, evidence: pd.DataFrame, known: Network) -> list[dict[str, Any]]:
    """The stretches that ``known`` has not, or for the other direction only, those with most passes first.

    ``begin`` and ``end`` are offsets on a learned edge, ``x`` and ``y`` the middle of a stretch [m].
    """
    edge, there = known.stations(STEP)
    mine, offset = learned.stations(STEP)
    heading, facing = known.heading(edge, there), learned.heading(mine, offset)
    points = learned.position(mine, offset)[:, :2]
    other = np.full(len(mine), SAME)
    near = cKDTree(known.position(edge, there)[:, :2]).query_ball_point(points, NEAR)
    for i, beside in enumerate(near):
        turn = np.cos(heading[beside] - facing[i]) if beside else np.zeros(0)
        if not (turn > ALIKE).any():
            against = np.flatnonzero(turn < -ALIKE)
            other[i] = edge[beside[against[0]]] if len(against) else NONE
    found, state = [], np.minimum(other, 0)
    change = np.flatnonzero((np.diff(mine) != 0) | (np.diff(state) != 0)) + 1
    for a, b in pairwise([0, *change.tolist(), len(mine)]):
        if state[a] == SAME or offset[b - 1] - offset[a] + STEP < SHORTEST:
            continue
        row, middle = evidence.iloc[int(mine[a])], (a + b) // 2
        found.append({
            "kind": "missing road" if state[a] == NONE else "wrong one-way",
            "edge_id": learned.edge_ids[mine[a]],
            "of_map": "" if state[a] == NONE else known.edge_ids[other[middle]],
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
