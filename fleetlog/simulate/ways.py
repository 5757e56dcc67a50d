"""Which lanes lead to one another, and the quickest ways between bays, over all their doors."""

import itertools
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.network import Network, build_network
from fleetlog.core.site import Site
from fleetlog.errors import SiteError
from fleetlog.roads.kernels.routes import quickest
from fleetlog.roads.routing import Router
from fleetlog.simulate.doors import Door
from fleetlog.simulate.track import Track
from fleetlog.store.dataset import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import STANDING_SPEED

OPPOSITE = 2.4  # A lane whose heading differs by more from that of another leads the other way [rad]
NODE, SEEN = 20.0, 2
"""Who changes to the opposite edge within so many metres of its node turns round there, if seen so often."""
TURN_REACH = 30.0  # A truck turns round at an open end onto lanes that begin at most this far away [m]
CROSSING = 3.0  # What crossing a lane on the way into a bay or out of it costs in choosing a way [s]
Begin = tuple[list[int], Index, Floats, Floats]  # Doors, -1: on the road; the rest see ``quickest``
NO_WAY_BACK = "no lane of the map leads back to where it began"


def parts(network: Network) -> Ints:
    """(E,) strongly connected part of every edge; -1 where none of the edges ahead leads back."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    size = len(network)
    turns = np.ones(len(network.next_edges))
    graph = csr_matrix((turns, network.next_edges, network.next_first), shape=(size, size))
    _, label = connected_components(graph, directed=True, connection="strong")
    return np.where((np.bincount(label)[label] == 1) & (graph.diagonal() == 0.0), -1, label).astype(np.int64)


def main_part(network: Network, wanted: Iterable[NDArray[np.integer]]) -> Mask:
    """(E,) the strongly connected part with most places, then longest; ``wanted``: edges near places."""
    if ((label := parts(network)) < 0).all():
        return np.zeros(len(network), dtype=bool)
    length = np.bincount(label[label >= 0], network.length[label >= 0])
    score = length / (length.sum() + 1.0)
    for edges in wanted:
        near = np.unique(label[edges])
        score[near[near >= 0]] += 1.0
    return np.asarray(label == int(np.argmax(score)))


def with_turns(network: Network, turns: Iterable[tuple[int, int]]) -> Network:
    """The network with further turns from one edge to another."""
    names, known = network.edge_ids, [(i, k) for i in range(len(network)) for k in network.successors(i)]
    pairs = [(names[a], names[b]) for a, b in (*known, *turns)]
    return build_network(network.edges(), pairs, has_elevation=network.has_elevation)


def recorded_turns(dataset: Dataset, network: Network) -> list[tuple[int, int]]:
    """Edges of a network at whose end recorded trucks turned round, each with the opposite edge."""
    found = each_day(dataset, _half_turns, kinds=(), cost=0.2e-6)
    none = np.zeros((0, 2), np.int64)
    pairs, count = np.unique(np.concatenate([none, *found]), axis=0, return_counts=True)
    found_ids = np.array(dataset.site.roads().edge_ids)[pairs[count >= SEEN]].tolist()
    return [(network.index[a], network.index[b]) for a, b in found_ids if {a, b} <= network.index.keys()]


def _half_turns(dataset: Dataset, vehicle: str, date: str) -> Ints:
    """(n, 2) edges, each with the opposite one that a truck went over to at its node without a stop."""
    t, network = dataset.read(vehicle, date, ("edge_id", "edge_offset", "speed")), dataset.site.roads()
    edge, offset = t.labels("edge_id").recode(network.index), t.floats("edge_offset")
    a, b = edge[:-1], edge[1:]
    drives = np.minimum(t.floats("speed")[:-1], t.floats("speed")[1:]) > STANDING_SPEED
    turned = (a >= 0) & (b >= 0) & (network.reverse[a] == b) & drives
    turned &= network.length[a] - offset[:-1] + offset[1:] < NODE
    return np.asarray(np.column_stack([a, b])[turned], dtype=np.int64)


def with_loops(site: Site) -> tuple[Site, list[str]]:
    """The site, with turning round at open ends where its map has no closed loop; and notes on it.
    Turns lead from lanes that lead nowhere to opposite lanes that begin there."""
    network = site.roads()
    if (parts(network) >= 0).any():
        return site, []
    every = np.arange(len(network), dtype=np.int32)
    leave, enter = network.heading(every, network.length), network.heading(every, np.zeros(len(network)))
    starts, ends = network.points[network.first[:-1]], network.points[network.first[1:] - 1]
    entered, turns = np.isin(every, network.next_edges), list[tuple[int, int]]()
    for i in np.flatnonzero(np.diff(network.next_first) == 0).tolist():
        near = np.linalg.norm(starts - ends[i], axis=1) <= TURN_REACH
        back = np.abs(np.angle(np.exp(1j * (enter - leave[i])))) > OPPOSITE
        turns += [(i, int(k)) for k in np.flatnonzero(~entered & near & back)]
    network, count = with_turns(network, turns), len({i for i, _ in turns})
    if (parts(network) < 0).all():
        what = f"{NO_WAY_BACK}: a truck that leaves a place could not return"
        raise SiteError(what, do="join the ends of the lanes, or draw roads in both directions")
    return replace(site, network=network), [f"{NO_WAY_BACK}: trucks turn round at open ends ({count})"]


class Itinerary(NamedTuple):
    """Out of door ``out`` (-1: on the road already) along ``pieces`` and in by ``door``; ``cost`` [s]."""

    out: int
    door: int
    pieces: Index
    cost: float


class Ways:
    """Answers for one site, by the traffic that there is."""

    def __init__(self, track: Track, router: Router, doors: list[Door], bays: int) -> None:
        self.router, self.turns, self._free = router, track.by_turn, router.time
        self.of_bay: list[list[int]] = [[] for _ in range(bays)]
        for d, door in enumerate(doors):
            self.of_bay[door.bay].append(d)
        self.pace = router.time / np.maximum(router.network.length, 1e-9)
        self._lane, self._crosses = np.array([(d.lane, d.crosses) for d in doors], np.int32).reshape(-1, 2).T
        self._at = np.array([d.at for d in doors], np.float64)
        self._past = (track.length[self._lane] - self._at) * self.pace[self._lane]
        self.lose(np.zeros(len(self._free)))

    def lose(self, seconds: Floats) -> None:
        """From now on so many seconds (E,) are lost on lanes, and in crossing them."""
        self.router.time = self._free + seconds
        extra = np.where(self._crosses >= 0, CROSSING + seconds[self._crosses], 0.0)
        # What going out by a door, and in by it, add to the time on whole lanes [s].
        self._out, self._in = extra - self._at * self.pace[self._lane], extra - self._past

    def rest(self, pieces: Index, at: float, door: int) -> float:
        """Seconds from offset ``at`` [m] of the first of some pieces to a door on the last; no turns."""
        lanes = pieces[pieces < len(self._free)]
        return float(self.router.time[lanes].sum() - at * self.pace[lanes[0]] + self._in[door])

    def between(self, start: int, end: int, closed: Iterable[int] = (), only: int = -1) -> Itinerary | None:
        """The quickest way from bay ``start`` to bay ``end``; with ``only`` out of that door."""
        out = self.of_bay[start] if only < 0 else [only]
        return self._way((out, self._lane[out], self._at[out], self._out[out]), end, closed, np.inf)

    def onward(
        self, lane: int, at: float, end: int, closed: Iterable[int] = (), most: float = np.inf
    ) -> Itinerary | None:
        """The quickest way from offset ``at`` [m] of a lane to bay ``end``, if that costs less."""
        on = np.array([lane], np.int32), np.array([at]), np.array([-at * self.pace[lane]])
        return self._way(([-1], *on), end, closed, most)

    def _way(self, begin: Begin, end: int, closed: Iterable[int], most: float) -> Itinerary | None:
        ends, graph = self.of_bay[end], self.router.graph(closed)
        doors = self._lane[ends], self._at[ends], self._in[ends]
        start, door, chain, cost = quickest(graph, *begin[1:], *doors, most)
        if start < 0:
            return None
        pieces = np.empty(2 * len(chain) - 1, np.int32)
        pieces[::2], pieces[1::2] = chain, [self.turns[turn] for turn in itertools.pairwise(chain.tolist())]
        return Itinerary(begin[0][start], ends[door], pieces, cost)
