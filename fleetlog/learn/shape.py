"""The shape of a road graph: short ends cut, short links closed, roads of two pieces joined."""

from collections import Counter, defaultdict
from itertools import pairwise

import networkx as nx
import numpy as np
from scipy.spatial import cKDTree

from fleetlog.core.arrays import Floats, Ints
from fleetlog.learn.lines import Chain, way

BACK = 2.5  # a road this many times longer than the straight line between two of its places has turned round
SPURIOUS = 0.1  # turns made by a smaller share of the trucks at both roads' ends are none
UNLIKE = 4.0  # a road that this many times fewer trucks go on is another one from there


def tidied(chains: list[Chain], spur: float, junction: float) -> list[Chain]:
    """The graph without dead ends shorter than ``spur`` [m] and links shorter than ``junction`` [m]."""
    before = -1
    while len(chains) != before:
        before = len(chains)
        chains = joined(_pruned(chains, spur))
        chains = joined(contracted(chains, np.full(len(chains), junction)))
    return chains


def ends(chains: list[Chain]) -> dict[int, list[tuple[int, bool]]]:
    """The (chain, whether it begins here) at each node."""
    out: dict[int, list[tuple[int, bool]]] = defaultdict(list)
    for k, chain in enumerate(chains):
        out[chain.start].append((k, True))
        out[chain.end].append((k, False))
    return out


def _fresh(chains: list[Chain]) -> int:
    """The number of a new node."""
    return max((max(c.start, c.end) for c in chains), default=0) + 1


def _pruned(chains: list[Chain], spur: float) -> list[Chain]:
    """Without the shortest short dead ends: the next one of a junction is part of a longer road by then."""
    gone = {-1}
    while gone:
        at = ends(chains)
        shortest: dict[int, int] = {}
        for k, c in sorted(enumerate(chains), key=lambda one: one[1].length):
            if c.length < spur and (len(at[c.start]) == 1 or len(at[c.end]) == 1 or c.start == c.end):
                shortest.setdefault(c.start if len(at[c.start]) > 1 else c.end, k)
        gone = set(shortest.values())
        chains = joined([c for k, c in enumerate(chains) if k not in gone])
    return chains


def contracted(chains: list[Chain], wide: Floats) -> list[Chain]:
    """Junctions that a link shorter than it is ``wide`` [m] joins become one, in the middle of them all."""
    at = ends(chains)
    where = {c.start: c.points[0] for c in chains} | {c.end: c.points[-1] for c in chains}
    links: nx.Graph[int] = nx.Graph()
    links.add_nodes_from(where)
    for c, width in zip(chains, wide, strict=True):
        if c.length < width and min(len(at[c.start]), len(at[c.end])) > 1:
            links.add_edge(c.start, c.end)
    centre: dict[int, Floats] = {}
    name: dict[int, int] = {}
    for group in nx.connected_components(links):
        members = [n for n in where if n in group]
        centre[members[0]] = np.mean([where[n] for n in members], axis=0)
        name |= dict.fromkeys(members, members[0])
    kept = []
    for c, width in zip(chains, wide, strict=True):
        a, b = name[c.start], name[c.end]
        if a != b or c.length >= 3.0 * width:
            kept.append(Chain(a, b, np.vstack([centre[a], c.points[1:-1], centre[b]])))
    return kept


def joined(chains: list[Chain], count: Ints | None = None) -> list[Chain]:
    """Chains that alone meet at a node are one; with passes ``count`` (n,), where as many go on."""
    chains = list(chains)
    at = ends(chains)
    total = np.ones(len(chains)) if count is None else count.astype(np.float64)
    for node in list(at):
        if len(at[node]) != 2 or at[node][0][0] == at[node][1][0]:
            continue
        (i, i_starts), (j, j_starts) = at[node]
        if max(total[i], total[j]) > UNLIKE * min(total[i], total[j]) + 3.0:
            continue
        a = chains[i].reversed() if i_starts else chains[i]
        b = chains[j] if j_starts else chains[j].reversed()
        chains[i] = Chain(a.start, b.end, np.concatenate([a.points, b.points[1:]]))
        total[i] = max(total[i], total[j])
        at[a.start] = [(i, True) if k == i else (k, s) for k, s in at[a.start]]
        at[b.end] = [(i, False) if k == j else (k, s) for k, s in at[b.end]]
        chains[j] = Chain(-1, -1, np.zeros((0, 2)))
        del at[node]
    return [c for c in chains if len(c.points)]


def pieces(chains: list[Chain], longest: float) -> list[Chain]:
    """The chains cut into pieces of at most ``longest`` [m]: what of a road was driven is asked of each."""
    out: list[Chain] = []
    fresh = _fresh(chains)
    for c in chains:
        n = int(np.ceil(c.length / longest))
        cuts = np.unique(np.linspace(0, len(c.points) - 1, max(n, 1) + 1).astype(int))
        nodes = [c.start, *range(fresh, fresh + len(cuts) - 2), c.end]
        fresh += len(cuts) - 2
        spans = zip(pairwise(nodes), pairwise(cuts), strict=True)
        out += [Chain(a, b, c.points[i : j + 1]) for (a, b), (i, j) in spans]
    return out


def apart(chains: list[Chain], near: float) -> list[Chain]:
    """Roads that come back within ``near`` [m] cut where they turn: a place beside both were on one twice."""
    out, waiting, fresh = [], list(chains), _fresh(chains)
    while waiting:
        c = waiting.pop()
        if at := _turning_point(c, near):
            waiting += [Chain(c.start, fresh, c.points[: at + 1]), Chain(fresh, c.end, c.points[at:])]
            fresh += 1
        else:
            out.append(c)
    return out


def _turning_point(c: Chain, near: float) -> int:
    """The vertex half way between the first two parts of a chain beside one another; 0 without."""
    passed = way(c.points)
    i, j = cKDTree(c.points).query_pairs(near, output_type="ndarray").reshape(-1, 2).T
    driven = np.abs(passed[j] - passed[i])
    if not len(beside := np.flatnonzero(driven > BACK * near)):
        return 0
    k = beside[np.argmin(driven[beside])]
    at = int(np.searchsorted(passed, 0.5 * (passed[i[k]] + passed[j[k]])))
    return at if at < len(passed) - 1 else 0


def split(chains: list[Chain], turns: Counter[tuple[int, int]]) -> list[Chain]:
    """Roads that cross where trucks never turn from one into the other do not meet: they pass through.
    ``turns`` counts how often chain a's end (2 a + 1; its start: 2 a) was left for that of chain b; a few
    turns among many that go elsewhere are rows matched to the wrong road."""
    chains = [Chain(c.start, c.end, c.points) for c in chains]
    fresh = _fresh(chains)
    for arms in ends(chains).values():
        for group in _turning(arms, turns)[1:]:
            for k, begins in group:
                setattr(chains[k], "start" if begins else "end", fresh)
            fresh += 1
    return chains


def _turning(arms: list[tuple[int, bool]], turns: Counter[tuple[int, int]]) -> list[list[tuple[int, bool]]]:
    """The arms of a junction in groups that trucks change between; lone arms go with the first."""
    mine = [2 * k + (not begins) for k, begins in arms]
    here = {pair: n for pair, n in turns.items() if set(mine).issuperset(pair)}
    busy = Counter[int]()
    for pair, n in here.items():
        busy.update(dict.fromkeys(pair, n))
    links: nx.Graph[int] = nx.Graph()
    links.add_nodes_from(mine)
    links.add_edges_from((a, b) for (a, b), n in here.items() if n >= SPURIOUS * min(busy[a], busy[b]))
    groups = sorted(nx.connected_components(links), key=lambda group: len(group) == 1)
    if len(pairs := [g for g in groups if len(g) > 1]) < 2:
        return [arms]
    pairs[0] = pairs[0].union(*groups[len(pairs) :])
    return [[(end // 2, end % 2 == 0) for end in sorted(g)] for g in pairs]
