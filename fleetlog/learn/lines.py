"""The floor that is road: a picture of the gathered cells, its middle lines, and these as a graph.

Its short ends are cut, its short links closed, roads of two pieces joined."""

from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.learn.cells import Driven

PIXEL = 0.25  # side of a pixel [m]
MOST_PIXELS = 30_000_000  # pixels of a picture; of a larger site they are coarser
BLUR = 0.6  # standard deviation of the blur that turns cells into passes [m]
STRAY = 0.06  # what is driven less than this share of what the floor nearby is, is scatter about it
NEARBY = 2.0  # ... within this [m]
ISLET = 4.0  # floor within a road smaller than this is part of it [m2]
AROUND = np.array([[-1, 0], [-1, 1], [0, 1], [1, 1], [1, 0], [1, -1], [0, -1], [-1, -1]])
BACK = 2.5  # a road this many times longer than the straight line between two of its places has turned round
SPURIOUS = 0.1  # turns made by a smaller share of the trucks at both roads' ends are none
UNLIKE = 4.0  # a road that this many times fewer trucks go on is another one from there


@dataclass
class Chain:
    """A road as it is known so far: ``points`` (n, 2) metres from node ``start`` to node ``end``."""

    start: int
    end: int
    points: Floats

    @property
    def length(self) -> float:
        """Metres."""
        return float(way(self.points)[-1])

    def reversed(self) -> "Chain":
        """The same road from its other end."""
        return Chain(self.end, self.start, self.points[::-1])


def way(points: Floats) -> Floats:
    """(n,) metres along a line to each of its points (n, 2)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


@dataclass(frozen=True)
class Picture:
    """Road pixels; pixel (row, column) has its middle at (x0 + column * side, y0 + row * side)."""

    road: Mask
    x0: float
    y0: float
    side: float

    def middle(self, pixel: Ints) -> Floats:
        """(N, 2) metres of (N, 2) rows and columns."""
        return np.column_stack([self.x0 + pixel[:, 1] * self.side, self.y0 + pixel[:, 0] * self.side])

    def chains(self) -> list[Chain]:
        """The chains of lines one pixel wide; a closed ring has one node, at any of its pixels."""
        road = self.road
        around = ndimage.convolve(road.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant") - 1
        knots, count = ndimage.label(road & (around != 2), structure=np.ones((3, 3)))
        links, _ = ndimage.label(road & (knots == 0), structure=np.ones((3, 3)))
        middles = ndimage.center_of_mass(knots > 0, knots, np.arange(1, count + 1)) if count else []
        node = self.middle(np.array(middles).reshape(-1, 2)) if count else np.zeros((0, 2))
        pixels = np.argwhere(links)
        number = links[tuple(pixels.T)]
        out, bounds = [], np.cumsum(np.bincount(number)[1:])[:-1]
        for ordered in map(_ordered, np.split(pixels[np.argsort(number, kind="stable")], bounds)):
            both = [_knots(knots, p) for p in (ordered[0], ordered[-1])]
            pair = both[0] if len(ordered) == 1 else [both[0][0], both[1][0]]
            inner = self.middle(ordered)
            if pair[0] == 0 or pair[1] == 0:
                node = np.concatenate([node, inner[:1]])
                pair = [len(node), len(node)]
            points = np.concatenate([node[pair[0] - 1][None], inner, node[pair[1] - 1][None]])
            out.append(Chain(pair[0] - 1, pair[1] - 1, points))
        return out


def centre_lines(cells: Driven, tube: float, least: float) -> Picture:
    """The middle lines, one pixel wide, of what is driven (cells gathered on their lines). Lines closer than
    ``tube`` [m] are one road; one with fewer passes than ``least`` is none."""
    rim = 10.0
    x0, y0 = float(cells.x.min()) - rim, float(cells.y.min()) - rim
    width, height = float(np.ptp(cells.x)) + 2 * rim, float(np.ptp(cells.y)) + 2 * rim
    side = max(PIXEL, np.sqrt(width * height / MOST_PIXELS))
    shape = int(height / side) + 1, int(width / side) + 1
    flat = np.round((cells.y - y0) / side).astype(np.int64) * shape[1]
    flat += np.round((cells.x - x0) / side).astype(np.int64)
    metres = np.bincount(flat, cells.weight, shape[0] * shape[1]).reshape(shape).astype(np.float32)
    blur = max(BLUR / side, 0.7)
    # a line that is driven once has one metre a metre: blurred, 1 / (sqrt(2 pi) sigma) a metre across
    passes = ndimage.gaussian_filter(metres, blur) * np.sqrt(2.0 * np.pi) * blur / side
    near = ndimage.maximum_filter(passes, size=2 * int(NEARBY / side) + 1)
    line = (metres > 0.0) & (passes >= np.maximum(least, STRAY * near))
    road = ndimage.distance_transform_edt(~line) <= max(0.5 * tube / side, 2.0)
    label, count = ndimage.label(~road)
    small = np.bincount(label.ravel(), minlength=count + 1) * side**2 < ISLET
    small[0] = False
    return Picture(thinned(road | small[label]), x0, y0, side)


def thinned(picture: Mask) -> Mask:
    """Lines one pixel wide (Zhang and Suen, 1984, doi:10.1145/357994.358023); the rim is empty."""
    picture, removed = picture.copy(), 1
    pixels = np.argwhere(picture)
    while removed:
        removed = 0
        for corners in (((0, 2, 4), (2, 4, 6)), ((0, 2, 6), (0, 4, 6))):
            near = picture[tuple(np.moveaxis(pixels[:, None] + AROUND, 2, 0))]
            count, rises = near.sum(axis=1), (~near & np.roll(near, -1, axis=1)).sum(axis=1)
            going = (count >= 2) & (count <= 6) & (rises == 1)
            for corner in corners:
                going &= ~near[:, corner].all(axis=1)
            picture[tuple(pixels[going].T)] = False
            pixels, removed = pixels[~going], removed + int(going.sum())
    return picture


def _ordered(pixels: Ints) -> Ints:
    """The pixels of a line one after another, from one of its ends."""
    line: nx.Graph[int] = nx.Graph()
    line.add_nodes_from(range(len(pixels)))
    line.add_edges_from(cKDTree(pixels).query_pairs(1.5))
    begin = next((i for i, count in line.degree if count < 2), 0)
    return pixels[list(nx.dfs_preorder_nodes(line, begin))]


def _knots(knots: Index, pixel: Ints) -> list[int]:
    """The two knots beside a pixel, one twice where there is one, 0 without."""
    r, c = pixel
    found = [int(k) for k in np.unique(knots[r - 1 : r + 2, c - 1 : c + 2]) if k]
    return (found * 2)[:2] if found else [0, 0]


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
