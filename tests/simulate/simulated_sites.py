"""Small sites for tests: grids, aisles, crossings, drawn from a seed."""

from __future__ import annotations

import numpy as np

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Place, Site
from fleetlog.core.truck import truck_from_dict

TRUCK = truck_from_dict({"chassis": {"mass": 4400.0}, "battery": {"capacity_wh": 30000.0}})


def road(name, a, b, points, oneway=False, limit=3.0, width=float("nan")):
    edge = Edge(name, a, b, np.column_stack([points, np.zeros(len(points))]), name, limit, width)
    return [edge] if oneway else [edge, reversed_edge(edge)]


def grid(
    columns=3, rows=3, pitch=30.0, seed=None, width=float("nan"), mirror=False, traffic="right", places=()
):
    """A grid; with a seed: nodes moved, some roads one-way, other limits and widths."""
    rng = np.random.default_rng(0 if seed is None else seed)
    node = {}
    for i in range(columns):
        for j in range(rows):
            shake = rng.uniform(-4, 4, 2) if seed is not None else (0.0, 0.0)
            node[i, j] = np.array([i * pitch + shake[0], j * pitch + shake[1]])
    if mirror:
        node = {k: p * [1.0, -1.0] for k, p in node.items()}
    edges, mark = [], "" if max(columns, rows) <= 10 else "_"
    for i in range(columns):
        for j in range(rows):
            for di, dj in ((1, 0), (0, 1)):
                if (i + di, j + dj) not in node:
                    continue
                inner = 0 < i < columns - 1 if dj else 0 < j < rows - 1
                # One-way only inside, so that the ring outside joins everything.
                oneway = seed is not None and inner and rng.random() < 0.4
                limit = float(rng.choice([2.0, 3.0, 4.5])) if seed is not None else 3.0
                wide = (
                    float(rng.choice([2.2, 4.0, 6.0], p=[0.2, 0.5, 0.3]))
                    if seed is not None and inner
                    else width
                )
                edges += road(
                    f"e{i}{mark}{j}{'h' if di else 'v'}", f"n{i}{mark}{j}", f"n{i + di}{mark}{j + dj}",
                    np.array([node[i, j], node[i + di, j + dj]]), oneway, limit, wide,
                )  # fmt: skip
    return Site("grid", network=build_network(edges), traffic=traffic, places=tuple(places))


def crossing(arm=40.0):
    """One crossing of two two-way roads, whose ends turn round; the case of the throughput plot."""
    centre = np.zeros(2)
    edges = []
    for name in "ensw":
        angle = {"e": 0.0, "n": 90.0, "w": 180.0, "s": 270.0}[name]
        tip = arm * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        edges += road(f"arm{name}", "c", f"t{name}", np.array([centre, np.round(tip, 9)]), limit=3.0)
    return Site("crossing", network=build_network(edges))


def aisle(width=2.2, length=60.0):
    """Two rings joined by a single-lane two-way aisle: opposing trucks must not meet in it."""
    edges = road("aisle", "a", "b", np.array([[0.0, 0.0], [length, 0.0]]), width=width)
    for name, x, sign in (("a", 0.0, -1.0), ("b", length, 1.0)):
        corner = [
            np.array([x, 0.0]),
            np.array([x + sign * 20, 20.0]),
            np.array([x + sign * 45, 0.0]),
            np.array([x + sign * 20, -20.0]),
        ]
        names = [name, f"{name}1", f"{name}2", f"{name}3"]
        for k in range(4):
            m = (k + 1) % 4
            edges += road(f"{name}ring{k}", names[k], names[m], np.array([corner[k], corner[m]]), width=6.0)
    return Site("aisle", network=build_network(edges))


def place(i, kind, x, y, **more):
    return Place(f"{kind}{i}", kind, x, y, **more)


PLACES = [
    place(1, "pick", 15, 3),
    place(1, "drop", 45, 33),
    place(2, "pick", 33, 45),
    place(2, "drop", 3, 45),
]
"""On a grid of three by three."""
