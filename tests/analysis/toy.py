"""The worked example of the placement notes: eight vertices, two one-way aisles, three two-way spurs, known rank vectors."""

import numpy as np

from fleetlog.core.network import Edge, build_network

ARCS = [
    ("A", "B", 20), ("B", "A", 20), ("B", "C", 30), ("C", "E", 30), ("E", "D", 30), ("D", "B", 30),
    ("E", "F", 20), ("F", "E", 20), ("E", "G", 15), ("G", "D", 15), ("D", "H", 25), ("H", "D", 25),
]  # fmt: skip
RUNS = [("ABCEFEDBA", 3, 0.80), ("ABCEDBCEGDBA", 2, 0.60), ("HDBCEDH", 2, 0.30), ("FEGDHDBCEF", 1, 0.20)]
NAMES = "ABCDEFGH"


def visits():
    return [np.array([NAMES.index(c) for c in run]) for run, times, _ in RUNS for _ in range(times)]


def network():
    angle = {c: 2 * np.pi * i / 8 for i, c in enumerate(NAMES)}
    edges = []
    for a, b, length in ARCS:
        p, q = (np.array([40 * np.cos(angle[c]), 40 * np.sin(angle[c]), 0.0]) for c in (a, b))
        # A detour of one vertex gives the line exactly the length that the example states where the chord is shorter.
        middle = (p + q) / 2
        chord = np.linalg.norm(q - p)
        half = np.sqrt(max((length / 2) ** 2 - (chord / 2) ** 2, 0.0))
        edges.append(Edge(f"{a}{b}", a, b, np.array([p, middle + [0, 0, half], q]), f"{a}{b}"))
    return build_network(edges)


def distances():
    from scipy.sparse.csgraph import dijkstra

    d = np.zeros((8, 8))
    for a, b, length in ARCS:
        d[NAMES.index(a), NAMES.index(b)] = length
    return dijkstra(d)
