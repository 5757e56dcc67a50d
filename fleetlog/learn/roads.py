"""The road graph of a recording: traces gathered on lines, joined to a graph, fitted to the traces.

Beside it how often which road was driven, by whom, on which days, how fast: its evidence."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import compress, pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fleetlog.core.arrays import DAY, Floats, Ints, Mask
from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.learn.cells import Driven, gathered
from fleetlog.learn.lines import Chain, apart, centre_lines, contracted, ends, joined, pieces, split, tidied
from fleetlog.learn.refine import CLEAR, SELDOM, Fit, refined, ways_driven
from fleetlog.roads.matching import Match, match
from fleetlog.roads.routing import Router

WHOLE = 0.6  # a visit that drives this share of an edge is a pass
LONGEST, SLACK = 3.0, 20.0  # a way between rows is no longer than 3 times the straight line, plus 20 m
STEADY = 0.3  # a truck slower than this stands or manoeuvres [m/s]
SPEED_STEP, SPEED_BINS = 0.1, 400
TUBE = 1.8  # lines that both directions share and that are closer than this are one [m]
LEAST = 0.05  # a line with fewer passes is none: half a manoeuvre, where nothing else was driven
REACH = 2.5  # traces farther than this from a road are another road's [m]
PIECE = 8.0  # length of the pieces of road that were driven or not [m]
BRIEF = 10.0  # a link shorter than this [m] is a manoeuvre ...
RARE = 0.1  # ... with a smaller share than this of the passes of the roads at its ends
Visit = tuple[int, float, float, int]  # An edge, from and to [m] on it, and the first row
Reread = Callable[[], Iterable[Trajectory]]


@dataclass
class Evidence:
    """What a recording says of the E edges of a network."""

    passes: Ints  # (E,) visits of a whole edge
    metres: Floats  # (E,) driven on it in all
    speeds: Ints  # (E, bins) on it, a histogram of 0.1 m/s
    turns: Counter[tuple[int, int]] = field(default_factory=Counter)
    vehicles: dict[int, set[str]] = field(default_factory=dict)
    days: dict[int, set[int]] = field(default_factory=dict)
    rows: int = 0
    matched: int = 0

    def mean_passes(self, network: Network) -> Ints:
        """(E,) how often each metre of an edge was driven on average."""
        return np.round(self.metres / network.length).astype(np.int64)


def gather_evidence(network: Network, trajectories: Iterable[Trajectory]) -> Evidence:
    """Match every trajectory and count; the network's turns bound what can be driven."""
    n = len(network)
    found = Evidence(np.zeros(n, np.int64), np.zeros(n), np.zeros((n, SPEED_BINS), np.int64))
    router = Router(network, speed=np.ones(n))
    for t in trajectories:
        m, speed = match(t, network), t.floats("speed")
        use = (m.edge >= 0) & ~m.standing & (speed > STEADY)
        step = np.minimum(speed[use] / SPEED_STEP, SPEED_BINS - 1).astype(np.int64)
        np.add.at(found.speeds, (m.edge[use], step), 1)
        found.rows += len(m)
        found.matched += int((m.edge >= 0).sum())
        for visits in _visits(m, t, router):
            found.turns.update(pairwise(edge for edge, *_ in visits))
            for edge, begin, end, row in visits:
                found.metres[edge] += max(end - begin, 0.0)
                found.passes[edge] += end - begin >= WHOLE * network.length[edge]
                found.vehicles.setdefault(edge, set()).add(t.vehicle_id)
                found.days.setdefault(edge, set()).add(int(t.time[row] // DAY))
    return found


def _visits(m: Match, t: Trajectory, router: Router) -> list[list[Visit]]:
    """The visits of every unbroken run of rows on roads, also between rows; parted where no way is known."""
    x, y, length, out = t.floats("x"), t.floats("y"), router.network.length.tolist(), list[list[Visit]]()
    on = np.flatnonzero(m.edge >= 0)
    fresh = np.append(True, (np.diff(on) > 1) | (m.restart[on[1:]] > 0))[: len(on)]
    change = fresh.copy()
    change[1:] |= m.edge[on[1:]] != m.edge[on[:-1]]
    # a ring of one edge, driven once more
    change[1:] |= np.diff(m.offset[on]) < -0.5 * router.network.length[m.edge[on[1:]]]
    for k, until in pairwise([*np.flatnonzero(change).tolist(), len(on)]):
        row, edge, end = int(on[k]), int(m.edge[on[k]]), float(m.offset[on[until - 1]])
        if fresh[k]:
            out.append([])
            begin = float(m.offset[row])
        if until == len(on) or fresh[until]:
            out[-1].append((edge, begin, end, row))
            continue
        last, after = on[until - 1 : until + 1]
        ahead, onward = int(m.edge[after]), float(m.offset[after])
        straight = float(np.hypot(x[after] - x[last], y[after] - y[last]))
        if ahead == router.network.reverse[edge]:
            turned = max(end, length[edge] - onward)
            out[-1].append((edge, begin, turned, row))
            begin = length[edge] - turned
        elif (way := _way(router, edge, ahead, LONGEST * straight + SLACK)) is None:
            out[-1].append((edge, begin, end, row))
            out.append([])
            begin = onward
        else:
            out[-1] += [(edge, begin, length[edge], row), *((e, 0.0, length[e], row) for e in way)]
            begin = 0.0
    return out


def _way(router: Router, edge: int, ahead: int, longest: float) -> list[int] | None:
    """The edges between two, [] where one follows the other, None where there is none so short [m]."""
    if ahead in router.network.successors(edge):
        return []
    route = router.route(edge, ahead)
    between = [] if route is None else route.edges[1:-1].tolist()
    return None if route is None or router.network.length[between].sum() > longest else between


@dataclass(frozen=True)
class Settings:
    """What the roads of a site are like."""

    lane: float = 2.3  # opposite directions closer than this are one road [m]
    spur: float = 7.0  # a shorter dead end is the way into a bay [m]
    passes: int = 1  # roads driven less often are left out


@dataclass(frozen=True)
class Roads:
    """The learned graph and its evidence; ``fits[i]`` and the direction ``forth[i]`` are those of edge i."""

    network: Network
    evidence: Evidence
    fits: list[Fit]
    forth: Mask


def learn_roads(cells: Driven, noise: float, reread: Reread, settings: Settings) -> Roads:
    """The roads under what was driven, its positions with ``noise`` [m]; ``reread`` gives tracks anew."""
    lines = centre_lines(gathered(cells, noise, settings.lane), TUBE, LEAST)
    graph = tidied(lines.chains(), settings.spur, lines.side * 3.0)
    graph = _driven_only(graph, reread, settings)
    graph = _driven_only(tidied(graph, settings.spur, settings.lane), reread, settings)
    while (met := _met(graph, cells, settings.lane)) is not None:
        graph = _driven_only(met, reread, settings)
    roads = _final(apart(graph, 2.0 * REACH), cells, reread)
    while (met := _returning(roads)) is not None:
        roads = _final(met, cells, reread)
    return roads


def _driven_only(graph: list[Chain], reread: Reread, settings: Settings) -> list[Chain]:
    """The parts of the chains that were driven, meeting where trucks turned from one into the other."""
    if not graph:
        do = "record longer or lower --min-passes"
        raise DataError("the dataset shows no road: no line was driven", do=do)
    graph = pieces(graph, PIECE)
    found = gather_evidence(build_network(two_way_edges(graph)), reread())
    total = found.passes.reshape(-1, 2).sum(axis=1)
    busiest = {n: max(total[k] for k, _ in arms) for n, arms in ends(graph).items()}
    ends_of = (min(busiest[c.start], busiest[c.end]) for c in graph)
    stray = [c.length < BRIEF and n < RARE * b for c, n, b in zip(graph, total, ends_of, strict=True)]
    keep = (total >= settings.passes) & ~np.array(stray)
    number = np.cumsum(keep) - 1
    turns: Counter[tuple[int, int]] = Counter()
    for (a, b), count in found.turns.items():
        if keep[a // 2] and keep[b // 2] and a // 2 != b // 2:
            # edge 2 k leaves chain k at its end and enters it at its start, edge 2 k + 1 the other way round
            turns[2 * int(number[a // 2]) + (a % 2 == 0), 2 * int(number[b // 2]) + (b % 2)] += count
    return joined(split(list(compress(graph, keep)), turns), total[keep])


def two_way_edges(graph: list[Chain]) -> list[Edge]:
    """Each chain forth and back: edges 2 k and 2 k + 1 are chain k."""
    edges: list[Edge] = []
    for k, c in enumerate(graph):
        points = np.column_stack([c.points, np.zeros(len(c.points))])
        edge = Edge(f"r{k + 1}", f"n{c.start}", f"n{c.end}", points, f"r{k + 1}")
        edges += [edge, reversed_edge(edge)]
    return edges


def _fitted(graph: list[Chain], senses: Mask, cells: Driven) -> list[Fit]:
    """The chains that are driven, on their traces."""
    if not len(some := np.flatnonzero(senses.any(axis=1))):
        raise DataError("shows no road that was driven from end to end", do="record for longer")
    return refined([graph[k] for k in some], senses[some], cells, REACH)


def _met(graph: list[Chain], cells: Driven, lane: float) -> list[Chain] | None:
    """The graph without links that are shorter than what trucks cover across them: these have no line that
    traces could show, and are the inside of one junction. Directions farther apart than ``lane`` [m] are two
    roads, which a link confuses: of it only what lies clear of its ends counts. None without such links."""
    fits = _fitted(graph, senses := ways_driven(graph, cells, REACH), cells)
    told = list(zip(fits, senses[senses.any(axis=1)], strict=True))
    confused = np.array([s.all() and np.ptp(f.left) > lane for f, s in told])
    met = contracted([f.chain for f in fits], [f.covered(s) for f, s in told] + 2.0 * CLEAR * confused)
    return met if len(met) < len(fits) else None


def _returning(roads: Roads) -> list[Chain] | None:
    """The graph without one-way links that no way leads back from and that lie within a junction: trucks
    cut corners there, and traces tell no direction. None without such links."""
    n = roads.network
    led = coo_array((np.ones(len(n)), (n.start, n.end)), shape=(len(n.node_ids),) * 2)
    part = connected_components(led, connection="strong")[1]
    lost = (part[n.start] != part[n.end]) & (n.length < 2.0 * CLEAR)
    each = np.flatnonzero(roads.forth | (n.reverse < 0))
    chains = [roads.fits[i].chain for i in each]
    met = contracted(chains, np.where(lost[each], 2.0 * CLEAR, 0.0))
    return met if len(met) < len(chains) else None


def _final(graph: list[Chain], cells: Driven, reread: Reread) -> Roads:
    """The graph on its traces, every road in the directions in which it is driven: what lies on it may be
    scatter of the lane beside, so they are asked of the trips too."""
    senses, used = ways_driven(graph, cells, REACH), np.zeros(1, bool)
    while not used.all():
        fits = _fitted(graph, senses, cells)
        edges, kept = two_way_edges([f.chain for f in fits]), np.flatnonzero(senses[senses.any(axis=1)])
        network = build_network([edges[i] for i in kept])
        evidence = gather_evidence(network, reread())
        mine = evidence.mean_passes(network)
        used = mine > SELDOM * np.where(network.reverse >= 0, mine[network.reverse], 0)
        senses.ravel()[np.flatnonzero(senses)[~used]] = False
    return Roads(network, evidence, [fits[i // 2] for i in kept], kept % 2 == 0)
