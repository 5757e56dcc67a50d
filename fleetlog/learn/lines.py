"""The floor that is road: a picture of the gathered cells, its middle lines, and these as a graph."""

from dataclasses import dataclass

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


def chains(picture: Picture) -> list[Chain]:
    """The chains of a thinned picture; a closed ring has one node, at any of its pixels."""
    road = picture.road
    around = ndimage.convolve(road.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant") - 1
    knots, count = ndimage.label(road & (around != 2), structure=np.ones((3, 3)))
    links, _ = ndimage.label(road & (knots == 0), structure=np.ones((3, 3)))
    middles = ndimage.center_of_mass(knots > 0, knots, np.arange(1, count + 1)) if count else []
    node = picture.middle(np.array(middles).reshape(-1, 2)) if count else np.zeros((0, 2))
    pixels = np.argwhere(links)
    number = links[tuple(pixels.T)]
    out, bounds = [], np.cumsum(np.bincount(number)[1:])[:-1]
    for ordered in map(_ordered, np.split(pixels[np.argsort(number, kind="stable")], bounds)):
        both = [_knots(knots, p) for p in (ordered[0], ordered[-1])]
        ends = both[0] if len(ordered) == 1 else [both[0][0], both[1][0]]
        inner = picture.middle(ordered)
        if ends[0] == 0 or ends[1] == 0:
            node = np.concatenate([node, inner[:1]])
            ends = [len(node), len(node)]
        points = np.concatenate([node[ends[0] - 1][None], inner, node[ends[1] - 1][None]])
        out.append(Chain(ends[0] - 1, ends[1] - 1, points))
    return out


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
