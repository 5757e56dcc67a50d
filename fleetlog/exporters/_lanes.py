"""A site's roads as points and straight lanes, for fleet managers whose graphs know nothing else."""

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Network
from fleetlog.core.site import Place, Site

STEP = 0.5  # Places are sought along the roads in steps of this [m]


@dataclass(frozen=True)
class Lane:
    """A straight piece of a directed edge between two points; ``limit`` [m/s] is NaN where unknown."""

    name: str
    start: str
    end: str
    length: float
    limit: float


@dataclass
class Lanes:
    """Points ((3,) metres by name), the lanes between them, and the point on the roads of each place."""

    points: dict[str, Floats] = field(default_factory=dict)
    lanes: list[Lane] = field(default_factory=list)
    stops: dict[str, Place] = field(default_factory=dict)


def lanes_of(site: Site) -> Lanes:
    """Every edge as a chain of lanes through its vertices and the places beside it. An edge and its reverse
    that share a line share its points. A place is reached from the nearest point of the nearest road; of
    several at one point the first counts."""
    n, out = site.roads(), Lanes()
    feet = _feet(site.places, n)
    for i, edge in enumerate(n.edge_ids):
        marks = feet[n.roads[i]]
        names = [_corner(n, i, xyz, out) for xyz in _through(n.polyline(i), [foot for _, foot in marks])]
        pieces = [(a, b) for a, b in pairwise(names) if a != b]
        for k, (a, b) in enumerate(pieces, 1):
            length = float(np.hypot(*(out.points[b] - out.points[a])[:2]))
            name = edge if len(pieces) == 1 else f"{edge}.{k}"
            out.lanes.append(Lane(name, a, b, length, float(n.speed_limit[i])))
        for place, foot in marks:
            out.stops.setdefault(_corner(n, i, foot, out), place)
    return out


def _feet(places: tuple[Place, ...], n: Network) -> dict[str, list[tuple[Place, Floats]]]:
    """By road: its places and the points (3,) on it from which they are reached."""
    found: dict[str, list[tuple[Place, Floats]]] = defaultdict(list)
    count = np.maximum(np.ceil(n.length / STEP).astype(int), 1)
    edge = np.repeat(np.arange(len(n), dtype=np.int32), count + 1)
    share = np.concatenate([np.linspace(0.0, 1.0, c + 1) for c in count])
    at = n.position(edge, share * n.length[edge])
    for place in places:
        k = int(np.argmin(np.hypot(at[:, 0] - place.x, at[:, 1] - place.y)))
        found[n.roads[edge[k]]].append((place, at[k]))
    return found


def _through(line: Floats, marks: list[Floats]) -> list[Floats]:
    """The vertices of a line and the marks on it, in order."""
    points = list(line)
    for mark in marks:
        to, step = np.linalg.norm(points - mark, axis=1), np.linalg.norm(np.diff(points, axis=0), axis=1)
        points.insert(int(np.argmin(to[:-1] + to[1:] - step)) + 1, mark)
    return points


def _corner(n: Network, edge: int, xyz: Floats, out: Lanes) -> str:
    """The name of the point at a place of an edge: its node's at the ends, else the road's with a number."""
    line, front = n.polyline(edge), f"{n.roads[edge]}/"
    for vertex, node in ((0, n.start[edge]), (-1, n.end[edge])):
        if np.linalg.norm(xyz - line[vertex]) < 1e-3:
            name = str(n.node_ids[node])
            out.points.setdefault(name, n.node_points[node])
            return name
    known = [name for name in out.points if name.startswith(front)]
    near = (name for name in known if np.linalg.norm(out.points[name] - xyz) < 1e-3)
    name = next(near, f"{front}{len(known) + 1}")
    out.points.setdefault(name, xyz)
    return name
