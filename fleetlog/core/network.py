"""The road network: directed edges with geometry, and which edge may follow which; distances from lines."""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.arrays import Floats, Index, Indices
from fleetlog.core.words import count
from fleetlog.errors import SiteError, chosen

if TYPE_CHECKING:
    import networkx as nx


@dataclass(frozen=True)
class Edge:
    """One directed edge as a map format describes it; the raw material of :class:`Network`. ``points`` is
    (n, 3), n >= 2, metres in the site frame, along the direction of travel. ``start``, ``end`` name nodes;
    both directions share ``road``; ``speed_limit`` [m/s], ``width`` [m] are NaN where unknown."""

    id: str
    start: str
    end: str
    points: Floats
    road: str
    speed_limit: float = float("nan")
    width: float = float("nan")


@dataclass(frozen=True)
class Network:
    """E directed edges as arrays; edge i is ``edge_ids[i]``; V nodes, P vertices."""

    edge_ids: tuple[str, ...]
    roads: tuple[str, ...]  # of each edge; an edge and its reverse share one
    node_ids: tuple[str, ...]
    start: Index  # (E,) nodes
    end: Index
    points: Floats  # (P, 3) vertices of all edges, end to end [m]
    first: Index  # (E + 1,): edge i owns points first[i]:first[i + 1]
    distance: Floats  # (P,) from its edge's start along the edge, in three dimensions [m]
    length: Floats  # (E,) [m]
    speed_limit: Floats  # (E,) [m/s], NaN unknown
    width: Floats  # (E,) [m], NaN unknown
    reverse: Index  # (E,) edge of the same road in the other direction, -1 where there is none
    next_first: Index  # (E + 1,): edge i may be followed by next_edges[next_first[i]:next_first[i + 1]]
    next_edges: Index
    has_elevation: bool = False  # without it z is 0 and slope is unknown, not level

    def __len__(self) -> int:
        return len(self.edge_ids)

    def edges(self) -> list[Edge]:
        """The edges one by one, as :func:`build_network` takes them."""
        names = [self.node_ids[i] for i in self.start], [self.node_ids[i] for i in self.end]
        sizes = self.roads, self.speed_limit.tolist(), self.width.tolist()
        lines = map(self.polyline, range(len(self)))
        return [Edge(*one) for one in zip(self.edge_ids, *names, lines, *sizes, strict=True)]

    @cached_property
    def index(self) -> dict[str, int]:
        """Edge index by id."""
        return {e: i for i, e in enumerate(self.edge_ids)}

    def edge(self, edge_id: str) -> int:
        """Index of ``edge_id``; :class:`SiteError` naming the nearest known one otherwise."""
        return chosen(self.index, edge_id, f"no edge {edge_id!r}", SiteError)

    @cached_property
    def node_points(self) -> Floats:
        """(V, 3) position of every node: the mean of the edge ends that meet there [m]."""
        node = np.concatenate([self.start, self.end])
        ends = self.points[np.concatenate([self.first[:-1], self.first[1:] - 1])]
        total = [np.bincount(node, axis, len(self.node_ids)) for axis in ends.T]
        return np.asarray(np.transpose(total) / np.bincount(node)[:, None], dtype=np.float64)

    def successors(self, edge: int) -> Index:
        """Indices of the edges that may follow ``edge``."""
        return self.next_edges[self.next_first[edge] : self.next_first[edge + 1]]

    def polyline(self, edge: int) -> Floats:
        """(n, 3) vertices of one edge [m]."""
        return self.points[self.first[edge] : self.first[edge + 1]]

    @cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """xmin, ymin, xmax, ymax [m]."""
        x, y = self.points[:, :2].T
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    @cached_property
    def turn(self) -> Floats:
        """(P,) angle by which the line turns at every vertex [rad], left positive; 0 at the ends of edges."""
        a, b = (np.diff(self.points[:, :2], axis=0)[k : len(self.points) - 2 + k].T for k in (0, 1))
        out = np.zeros(len(self.points))
        out[1:-1] = np.arctan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
        out[self.first[:-1]] = out[self.first[1:] - 1] = 0.0
        return out

    @cached_property
    def _ladder(self) -> tuple[Floats, Floats]:
        """Vertex distances and edge starts on one growing axis, so one search serves all edges."""
        starts = np.arange(len(self), dtype=np.float64) * (float(self.length.max(initial=0.0)) + 1.0)
        return self.distance + np.repeat(starts, np.diff(self.first)), starts

    def segment(self, edge: Index, offset: Floats) -> tuple[Indices, Floats]:
        """Vertex before each of (N,) edges and offsets [m], and the share of that segment that is passed."""
        ladder, starts = self._ladder
        offset = np.clip(offset, 0.0, self.length[edge])
        k = np.searchsorted(ladder, starts[edge] + offset, side="right") - 1
        k = np.clip(k, self.first[edge], self.first[np.asarray(edge) + 1] - 2)
        span = np.maximum(self.distance[k + 1] - self.distance[k], 1e-12)
        return k, np.asarray((offset - self.distance[k]) / span, dtype=np.float64)

    def stations(self, step: float = 1.0) -> tuple[Index, Floats]:
        """Edges and offsets [m] of places about ``step`` [m] apart on all edges."""
        count = np.maximum(np.ceil(self.length / step).astype(int), 1)
        edge = np.repeat(np.arange(len(self), dtype=np.int32), count)
        nth = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
        return edge, (nth + 0.5) * (self.length / count)[edge]

    def position(self, edge: Index, offset: Floats) -> Floats:
        """(N, 3) places in the site frame [m]."""
        k, share = self.segment(edge, offset)
        onward: Floats = self.points[k + 1] - self.points[k]
        return self.points[k] + share[:, None] * onward

    def heading(self, edge: Index, offset: Floats) -> Floats:
        """(N,) direction of travel [rad], counter-clockwise from east."""
        k, _ = self.segment(edge, offset)
        dx, dy, _ = (self.points[k + 1] - self.points[k]).T
        return np.asarray(np.arctan2(dy, dx), dtype=np.float64)

    def slope(self, edge: Index, offset: Floats) -> Floats:
        """(N,) slope angle along the direction of travel [rad], uphill positive; 0 without elevation."""
        k, _ = self.segment(edge, offset)
        dx, dy, dz = (self.points[k + 1] - self.points[k]).T
        return np.asarray(np.arctan2(dz, np.maximum(np.hypot(dx, dy), 1e-9)), dtype=np.float64)

    def without(self, closed: Collection[str]) -> "Network":
        """The network without some roads, named as a road (both directions) or as an edge. Turns stay as they
        are; where none is left a truck may turn round, as at any dead end."""
        for name in set(closed) - set(self.roads):
            self.edge(name)
        kept = {i: e for i, e in enumerate(self.edges()) if e.id not in closed and e.road not in closed}
        turns = []
        for i, edge in kept.items():
            follow = [j for j in self.successors(i).tolist() if j in kept]
            if not follow and self.reverse[i] in kept:
                follow = [int(self.reverse[i])]
            turns += [(edge.id, self.edge_ids[j]) for j in follow]
        return build_network([*kept.values()], turns, has_elevation=self.has_elevation)

    def to_networkx(self) -> "nx.DiGraph[int]":
        """The line graph, edge to edge; ``length`` [m] of an arc is that of the edge it leaves."""
        import networkx as nx

        graph: nx.DiGraph[int] = nx.DiGraph()
        graph.add_nodes_from(range(len(self)))
        for i in range(len(self)):
            graph.add_edges_from(((i, int(j)) for j in self.successors(i)), length=float(self.length[i]))
        return graph


def reverse_id(edge_id: str) -> str:
    """Id of the other direction of a road digitised once: ``r`` and ``-r``, as SUMO writes it."""
    return edge_id[1:] if edge_id.startswith("-") else "-" + edge_id


def reversed_edge(edge: Edge) -> Edge:
    """The same road in the other direction."""
    points = edge.points[::-1].copy()
    return replace(edge, id=reverse_id(edge.id), start=edge.end, end=edge.start, points=points)


def build_network(
    edges: Sequence[Edge], turns: Iterable[tuple[str, str]] | None = None,
    forbidden: Iterable[tuple[str, str]] = (), has_elevation: bool | None = None,
) -> Network:  # fmt: skip
    """Edges as a :class:`Network`.

    edges : in any order; ids must differ.
    turns : the allowed (edge id, next edge id).  By default every edge that leaves the node where one ends
        may follow it; its own reverse only at a dead end.
    forbidden : (edge id, next edge id) to leave out of the default.
    has_elevation : by default whether any height differs from another."""
    if not edges:
        do = "check the lane types or road classes that are kept"
        raise SiteError("the map has no drivable road", do=do)
    index = {e.id: i for i, e in enumerate(edges)}
    if len(index) != len(edges):
        twice, _ = Counter(e.id for e in edges).most_common(1)[0]
        raise SiteError(f"two roads share the id {twice!r}", do="give every road an id of its own")
    nodes: dict[str, int] = {}
    start = np.array([nodes.setdefault(e.start, len(nodes)) for e in edges], dtype=np.int32)
    end = np.array([nodes.setdefault(e.end, len(nodes)) for e in edges], dtype=np.int32)
    points = np.concatenate([np.asarray(e.points, dtype=np.float64) for e in edges])
    first = np.concatenate([[0], np.cumsum([len(e.points) for e in edges])]).astype(np.int32)
    steps = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
    steps[first[:-1]] = 0.0
    distance = np.cumsum(steps)
    distance -= np.repeat(distance[first[:-1]], np.diff(first))
    reverse = np.full(len(edges), -1, dtype=np.int32)
    for i, e in enumerate(edges):
        j = index.get(reverse_id(e.id), -1)
        if j >= 0 and edges[j].road == e.road and start[j] == end[i] and end[j] == start[i]:
            reverse[i] = j
    if turns is None:
        leaving: dict[str, list[str]] = {}
        for e in edges:
            leaving.setdefault(e.start, []).append(e.id)
        turns, banned = list[tuple[str, str]](), {*forbidden}
        for e, back in zip(edges, reverse.tolist(), strict=True):
            ways = [way for way in leaving.get(e.end, []) if (e.id, way) not in banned]
            onward = [way for way in ways if back < 0 or way != edges[back].id]
            turns += [(e.id, way) for way in onward or ways]
    follow = np.unique(np.array([(index[a], index[b]) for a, b in turns], np.int32).reshape(-1, 2), axis=0)
    return Network(
        tuple(index), tuple(e.road for e in edges), tuple(nodes), start, end, points, first, distance,
        length=distance[first[1:] - 1].copy(),
        speed_limit=np.array([e.speed_limit for e in edges], dtype=np.float64),
        width=np.array([e.width for e in edges], dtype=np.float64), reverse=reverse,
        next_first=np.searchsorted(follow[:, 0], np.arange(len(edges) + 1)).astype(np.int32),
        next_edges=follow[:, 1].copy(),
        has_elevation=bool(np.ptp(points[:, 2]) > 1e-6) if has_elevation is None else has_elevation,
    )  # fmt: skip


@dataclass(frozen=True)
class LoadReport:
    """What became of the roads of a map file; ``dropped`` counts those left out by reason."""

    format: str
    read: int
    kept: int
    dropped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def line(self) -> str:
        """One sentence for the terminal."""
        why = ", ".join(f"{n} {reason}" for reason, n in self.dropped.items())
        left_out = f" (left out: {why})" if why else ""
        return f"{self.format}: {count(self.read, 'road')} read, {self.kept:,} kept{left_out}"


def distance_to_segment(points: Floats, a: Floats, b: Floats) -> Floats:
    """(N,) distance of points from the segments a to b; each (N, d), or (d,) where it is one for all."""
    d = b - a
    share = ((points - a) * d).sum(axis=-1) / np.maximum((d * d).sum(axis=-1), 1e-18)
    return np.asarray(np.linalg.norm(a + np.clip(share, 0.0, 1.0)[..., None] * d - points, axis=-1))


def reduced(line: Floats, tolerance: float) -> Floats:
    """A polyline (n, d) with few of its points, true to ``tolerance`` [m] (Douglas and Peucker 1973)."""
    keep = np.zeros(len(line), dtype=bool)
    keep[[0, -1]] = True
    todo = [(0, len(line) - 1)]
    while todo:
        a, b = todo.pop()
        if b - a < 2:
            continue
        gap = distance_to_segment(line[a + 1 : b], line[a], line[b])
        worst = a + 1 + int(gap.argmax())
        if gap.max() > tolerance:
            keep[worst] = True
            todo += [(a, worst), (worst, b)]
    return line[keep]
