"""Roads and tracks drawn as little maps.

A capital letter is a node, ``-`` and ``|`` are two-way roads, ``>``, ``<``, ``^`` and ``v`` make a road one-way, and a digit (0 to 9,
then a to z) is a position of the track, in that order, a second apart.  One column is ``scale`` metres, one line twice that.
"""

from __future__ import annotations

import numpy as np

from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.trajectory import Trajectory

ORDER = "0123456789abcdefghijklmnopqrstuvwxyz"


def draw(text: str, scale: float = 2.0, extra: str = "") -> tuple[Network, Trajectory]:
    """The network and the track of a drawing; ``extra`` adds positions in a second drawing laid over the first."""
    cells = _cells(text)
    network = build_network(_edges(cells, scale))
    track = {**cells, **{k: c for k, c in _cells(extra).items() if c in ORDER}}
    fixes = sorted((ORDER.index(c), k) for k, c in track.items() if c in ORDER)
    xy = np.array([_place(k, scale) for _, k in fixes]).reshape(-1, 2)
    time = np.array([i for i, _ in fixes], np.int64) * 1_000_000
    return network, Trajectory("truck", time, {"x": xy[:, 0].copy(), "y": xy[:, 1].copy()})


def _cells(text: str) -> dict[tuple[int, int], str]:
    return {
        (i, j): c for j, line in enumerate(text.splitlines()) for i, c in enumerate(line) if not c.isspace()
    }


def _place(cell: tuple[int, int], scale: float) -> tuple[float, float]:
    return cell[0] * scale, -2.0 * cell[1] * scale


def _edges(cells: dict[tuple[int, int], str], scale: float) -> list[Edge]:
    out = []
    for (i, j), c in cells.items():
        if not c.isupper():
            continue
        for di, dj, marks, ahead, against in ((1, 0, "-<>", ">", "<"), (0, 1, "|^v", "v", "^")):
            way, k = "", 1
            while (d := cells.get((i + k * di, j + k * dj), " ")) in marks or d in ORDER:
                way += d
                k += 1
            if not d.isupper() or not way:
                continue
            ends = np.array([[*_place((i, j), scale), 0.0], [*_place((i + k * di, j + k * dj), scale), 0.0]])
            edge = Edge(c + d, c, d, ends, c + d)
            if against in way:
                out.append(Edge(d + c, d, c, ends[::-1].copy(), d + c))
            else:
                out += [edge] if ahead in way else [edge, reversed_edge(edge)]
    return out
