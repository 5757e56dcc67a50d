"""Where lines drawn without nodes meet: coinciding ends become nodes, shared inner vertices split."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fleetlog.roads.formats.base import Floats

TOLERANCE = 0.1
"""Vertices nearer than this [m] are one place; well under half the width of any road."""


@dataclass(frozen=True)
class Line:
    """A road as drawn: ``points`` (n, 3) longitude, latitude, height; its nodes "" where not named.

    ``traits`` are its speed limit [m/s], width [m] and whether it is one-way.
    """

    id: str
    points: Floats
    start: str
    end: str
    traits: tuple[float, float, bool]


def join_lines(lines: list[Line], split: bool, notes: list[str]) -> list[Line]:
    """Lines with nodes.  Inner vertices that lie on a vertex of another road split theirs where ``split``."""
    first = np.concatenate([[0], np.cumsum([len(line.points) for line in lines])])
    owner = np.repeat(np.arange(len(lines)), np.diff(first))
    place = _places(_metres(np.concatenate([line.points for line in lines])), owner, first)
    names = {int(place[first[k]]): line.start for k, line in enumerate(lines) if line.start}
    names |= {int(place[first[k + 1] - 1]): line.end for k, line in enumerate(lines) if line.end}
    # A place is shared where vertices of two roads fall together.
    low, high = np.full(place.max() + 1, len(lines)), np.full(place.max() + 1, -1)
    np.minimum.at(low, place, owner)
    np.maximum.at(high, place, owner)
    shared = low != high
    out: list[Line] = []
    divided = 0
    for k, line in enumerate(lines):
        own = place[first[k] : first[k + 1]]
        cuts = _cuts(own, shared) if split else []
        divided += bool(cuts)
        out += _pieces(line, own, cuts, names)
    if divided:
        where = "where a vertex of another road lies on one of theirs"
        notes.append(f"{divided} roads are split, as ID:0, ID:1 ..., {where}")
    return out


def _cuts(own: NDArray[np.int64], shared: NDArray[np.bool_]) -> list[int]:
    inner = np.flatnonzero(shared[own[1:-1]] & (own[1:-1] != own[0]) & (own[1:-1] != own[-1])) + 1
    return [int(i) for n, i in enumerate(inner) if n == 0 or own[i] != own[inner[n - 1]]]


def _pieces(line: Line, own: NDArray[np.int64], cuts: list[int], names: dict[int, str]) -> list[Line]:
    bounds = [0, *cuts, len(own) - 1]
    out = []
    for n, (a, b) in enumerate(pairwise(bounds)):
        start = line.start if n == 0 and line.start else names.get(int(own[a]), f"@{own[a]}")
        end = line.end if b == bounds[-1] and line.end else names.get(int(own[b]), f"@{own[b]}")
        name = f"{line.id}:{n}" if cuts else line.id
        out.append(replace(line, id=name, points=line.points[a : b + 1], start=start, end=end))
    return out


def _metres(points: Floats) -> Floats:
    """Rough metres about the first vertex; good to a per mille, enough to see which vertices coincide."""
    degree = 111_200.0
    scale = np.array([degree * np.cos(np.radians(points[0, 1])), degree, 1.0])
    return np.asarray(np.nan_to_num((points - points[0]) * scale), dtype=np.float64)


def _places(points: Floats, owner: NDArray[np.intp], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """(P,) place of each vertex: groups within the tolerance, of several roads or of road ends."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    end = np.zeros(len(points), dtype=bool)
    end[first[:-1]] = end[first[1:] - 1] = True
    a, b = cKDTree(points).query_pairs(TOLERANCE, output_type="ndarray").T
    # A densely drawn road must not shrink into one place: its own vertices join only at its two ends.
    keep = (owner[a] != owner[b]) | (end[a] & end[b])
    graph = coo_matrix((np.ones(keep.sum()), (a[keep], b[keep])), shape=(len(points),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
