"""The road graph of a recording: traces gathered on lines, joined to a graph, fitted to the traces."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import compress

import numpy as np

from fleetlog.core.arrays import Mask
from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.learn.cells import Cells, gathered
from fleetlog.learn.evidence import Evidence, gather_evidence
from fleetlog.learn.lines import Chain, centre_lines, chains
from fleetlog.learn.refine import Fit, passes, refined
from fleetlog.learn.shape import apart, ends, joined, pieces, split, tidied

TUBE = 1.8  # lines that both directions share and that are closer than this are one [m]
LEAST = 0.05  # a line with fewer passes is none: half a manoeuvre, where nothing else was driven
REACH = 2.5  # traces farther than this from a road are another road's [m]
PIECE = 8.0  # length of the pieces of road that were driven or not [m]
BRIEF = 10.0  # a link shorter than this [m] is a manoeuvre ...
RARE = 0.1  # ... with a smaller share than this of the passes of the roads at its ends
SELDOM = 0.06  # a direction with a smaller share of the other one's passes is not one in which trucks drive

Reread = Callable[[], Iterable[Trajectory]]


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


def learn_roads(cells: Cells, noise: float, reread: Reread, settings: Settings) -> Roads:
    """The roads under what was driven, given the noise of its positions [m].

    ``reread`` gives the trajectories anew, for what is counted on the roads found.
    """
    lines = centre_lines(gathered(cells, noise, settings.lane), TUBE, LEAST)
    graph = tidied(chains(lines), settings.spur, lines.side * 3.0)
    graph = _driven_only(graph, reread, settings)
    graph = _driven_only(tidied(graph, settings.spur, settings.lane), reread, settings)
    return _final(apart(graph, 2.0 * REACH), cells, reread)


def _driven_only(graph: list[Chain], reread: Reread, settings: Settings) -> list[Chain]:
    """The parts of the chains that were driven, meeting where trucks turned from one into the other."""
    if not graph:
        raise DataError("shows no road: no line was driven", do="record for longer, or lower --min-passes")
    graph = pieces(graph, PIECE)
    found = gather_evidence(build_network(two_way_edges(graph)), reread())
    total = found.passes.reshape(-1, 2).sum(axis=1)
    busiest = {n: max(total[k] for k, _ in arms) for n, arms in ends(graph).items()}
    ends_of = (min(busiest[c.start], busiest[c.end]) for c in graph)
    stray = [c.length < BRIEF and n < RARE * b for c, n, b in zip(graph, total, ends_of, strict=True)]
    keep = (total >= settings.passes) & ~np.array(stray)
    kept = list(compress(graph, keep))
    number = np.cumsum(keep) - 1
    turns: Counter[tuple[int, int]] = Counter()
    for (a, b), count in found.turns.items():
        if keep[a // 2] and keep[b // 2] and a // 2 != b // 2:
            # edge 2 k leaves chain k at its end and enters it at its start, edge 2 k + 1 the other way round
            turns[2 * int(number[a // 2]) + (a % 2 == 0), 2 * int(number[b // 2]) + (b % 2)] += count
    return joined(split(kept, turns), total[keep])


def two_way_edges(graph: list[Chain]) -> list[Edge]:
    """Each chain forth and back: edges 2 k and 2 k + 1 are chain k."""
    edges: list[Edge] = []
    for k, c in enumerate(graph):
        points = np.column_stack([c.points, np.zeros(len(c.points))])
        edge = Edge(f"r{k + 1}", f"n{c.start}", f"n{c.end}", points, f"r{k + 1}")
        edges += [edge, reversed_edge(edge)]
    return edges


def _final(graph: list[Chain], cells: Cells, reread: Reread) -> Roads:
    """The graph on its traces, every road in the directions in which it is driven."""
    driven = passes(graph, cells, REACH)
    senses = driven > SELDOM * driven[:, ::-1]
    some = np.flatnonzero(senses.any(axis=1))
    graph, senses = [graph[k] for k in some], senses[some]
    if not graph:
        raise DataError("shows no road that was driven from end to end", do="record for longer")
    fits = refined(graph, senses, cells, REACH)
    edges = two_way_edges([f.chain for f in fits])
    kept, used = np.flatnonzero(senses.ravel()), np.zeros(1, bool)
    while not used.all():
        network = build_network([edges[i] for i in kept])
        evidence = gather_evidence(network, reread())
        used = evidence.mean_passes(network) > 0
        kept = kept[used]
    return Roads(network, evidence, [fits[i // 2] for i in kept], kept % 2 == 0)
