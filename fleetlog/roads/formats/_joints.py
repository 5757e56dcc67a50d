"""Where lines drawn without nodes meet: coinciding ends become nodes, shared inner vertices split."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Edge
from fleetlog.roads.formats.base import Floats

TOLERANCE = 0.1
"""Vertices nearer than this [m] are one place; well under half the width of any road."""


def join_lines(lines: list[Edge], split: bool, notes: list[str]) -> list[Edge]:
    """Lines in degrees with the nodes "" named; ``road`` stays.

    Inner vertices that lie on a vertex of another road split theirs where ``split``.
    """
    first = np.concatenate([[0], np.cumsum([len(line.points) for line in lines])])
    owner = np.repeat(np.arange(len(lines)), np.diff(first))
    place = _places(np.concatenate([line.points for line in lines]), owner, first)
    names = {int(place[first[k]]): line.start for k, line in enumerate(lines) if line.start}
    names |= {int(place[first[k + 1] - 1]): line.end for k, line in enumerate(lines) if line.end}
    # A place is shared where vertices of two roads fall together.
    low, high = np.full(place.max() + 1, len(lines)), np.full(place.max() + 1, -1)
    np.minimum.at(low, place, owner)
    np.maximum.at(high, place, owner)
    shared = (low != high) & split
    out: list[Edge] = []
    divided = 0
    for k, line in enumerate(lines):
        own = place[first[k] : first[k + 1]]
        cut = shared[own] & (own != own[0]) & (own != own[-1])
        cut[1:] &= own[1:] != own[:-1]
        bounds = [0, *np.flatnonzero(cut).tolist(), len(own) - 1]
        divided += len(bounds) > 2
        nodes = [names.get(p, f"@{p}") for p in own[bounds].tolist()]
        nodes[0], nodes[-1] = line.start or nodes[0], line.end or nodes[-1]
        for n, ((a, b), (start, end)) in enumerate(zip(pairwise(bounds), pairwise(nodes), strict=True)):
            name = f"{line.id}:{n}" if len(bounds) > 2 else line.id
            out.append(replace(line, id=name, points=line.points[a : b + 1], start=start, end=end))
    if divided:
        where = "where a vertex of another road lies on one of theirs"
        notes.append(f"{divided} roads are split, as ID:0, ID:1 ..., {where}")
    return out


def _places(points: Floats, owner: NDArray[np.intp], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """(P,) place of each vertex: groups within the tolerance, of several roads or of road ends."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Rough metres about the first vertex; good to a per mille, enough to see which vertices coincide.
    degree = 111_200.0
    scale = np.array([degree * np.cos(np.radians(points[0, 1])), degree, 1.0])
    metres = np.nan_to_num((points - points[0]) * scale)
    end = np.zeros(len(points), dtype=bool)
    end[first[:-1]] = end[first[1:] - 1] = True
    a, b = cKDTree(metres).query_pairs(TOLERANCE, output_type="ndarray").T
    # A densely drawn road must not shrink into one place: its own vertices join only at its two ends.
    keep = (owner[a] != owner[b]) | (end[a] & end[b])
    graph = coo_matrix((np.ones(keep.sum()), (a[keep], b[keep])), shape=(len(points),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
