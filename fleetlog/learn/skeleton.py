"""Lines of pixels as a graph: nodes where they meet or end, chains of pixels between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fleetlog.learn.raster import Picture

Floats = NDArray[np.float64]
AROUND = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Steps to the pixels beside one, straight ones first."""


@dataclass
class Chain:
    """A road as it is known so far: ``points`` (n, 2) metres from node ``start`` to node ``end``."""

    start: int
    end: int
    points: Floats

    @property
    def way(self) -> Floats:
        """(n,) metres from the start to each point."""
        return way(self.points)

    @property
    def length(self) -> float:
        """Metres."""
        return float(self.way[-1])

    def reversed(self) -> Chain:
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
    links, number = ndimage.label(road & (knots == 0), structure=np.ones((3, 3)))
    middles = ndimage.center_of_mass(knots > 0, knots, np.arange(1, count + 1)) if count else []
    node = picture.middle(np.array(middles).reshape(-1, 2)) if count else np.zeros((0, 2))
    out, places = [], ndimage.find_objects(links)
    for k in range(number):
        rows, columns = places[k]
        pixels = np.argwhere(links[places[k]] == k + 1) + np.array([rows.start, columns.start])
        ordered = _ordered(pixels)
        ends = [_knots(knots, p)[0] for p in (ordered[0], ordered[-1])]
        if len(ordered) == 1:
            ends = _knots(knots, ordered[0])
        inner = picture.middle(ordered)
        if ends[0] == 0 or ends[1] == 0:
            node = np.concatenate([node, inner[:1]])
            ends = [len(node), len(node)]
        points = np.concatenate([node[ends[0] - 1][None], inner, node[ends[1] - 1][None]])
        out.append(Chain(ends[0] - 1, ends[1] - 1, points))
    return out


def _ordered(pixels: NDArray[np.int64]) -> NDArray[np.int64]:
    """The pixels of a line one after another, from one of its ends."""
    index = {(r, c): i for i, (r, c) in enumerate(pixels.tolist())}
    near = [[index[r + a, c + b] for a, b in AROUND if (r + a, c + b) in index] for r, c in index]
    here: int | None = next((i for i, n in enumerate(near) if len(n) < 2), 0)
    order: dict[int, None] = {}
    while here is not None:
        order[here] = None
        here = next((j for j in near[here] if j not in order), None)
    return pixels[list(order)]


def _knots(knots: NDArray[np.int32], pixel: NDArray[np.int64]) -> list[int]:
    """The two knots beside a pixel, one twice where there is one, 0 without."""
    r, c = pixel
    found = [int(k) for k in np.unique(knots[r - 1 : r + 2, c - 1 : c + 2]) if k]
    return (found * 2)[:2] if found else [0, 0]
