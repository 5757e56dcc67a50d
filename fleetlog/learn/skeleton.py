"""Lines of pixels as a graph: nodes where they meet or end, chains of pixels between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fleetlog.learn.raster import Picture

Floats = NDArray[np.float64]


@dataclass
class Chain:
    """A road as it is known so far: ``points`` (n, 2) metres from node ``start`` to node ``end``."""

    start: int
    end: int
    points: Floats

    @property
    def length(self) -> float:
        """Metres."""
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())


def chains(picture: Picture) -> list[Chain]:
    """The chains of a thinned picture; a closed ring has one node, at any of its pixels."""
    road = picture.road > 0
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
        ends = [_knot(knots, p) for p in (ordered[0], ordered[-1])]
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
    index = {(int(r), int(c)): i for i, (r, c) in enumerate(pixels)}
    near = [_neighbours(index, int(r), int(c)) for r, c in pixels]
    here = next((i for i, n in enumerate(near) if len(n) < 2), 0)
    order, seen = [here], {here}
    while True:
        onward = [j for j in near[here] if j not in seen]
        if not onward:
            return pixels[order]
        here = onward[0]
        order.append(here)
        seen.add(here)


def _neighbours(index: dict[tuple[int, int], int], r: int, c: int) -> list[int]:
    steps = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
    return [index[r + a, c + b] for a, b in steps if (r + a, c + b) in index]


def _knots(knots: NDArray[np.int32], pixel: NDArray[np.int64]) -> list[int]:
    r, c = pixel
    found = [int(k) for k in np.unique(knots[r - 1 : r + 2, c - 1 : c + 2]) if k]
    return (found * 2)[:2] if found else [0, 0]


def _knot(knots: NDArray[np.int32], pixel: NDArray[np.int64]) -> int:
    return _knots(knots, pixel)[0]
