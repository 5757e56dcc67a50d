"""Density, heat map and p-median beside their peers, in one run; CPU seconds of one core.

python tests/benchmarks/analysis.py [density|heatmap|pmedian]
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import sys
import time
from itertools import product

import networkx as nx
import numpy as np

from fleetlog.core.network import Edge, Network, build_network, reversed_edge


def grid(nx_: int, ny: int, pitch: float) -> Network:
    """A two-way aisle grid."""
    edges = []
    for i, j in product(range(nx_), range(ny)):
        for di, dj in ((1, 0), (0, 1)):
            if i + di < nx_ and j + dj < ny:
                p = np.array([[i * pitch, j * pitch, 0], [(i + di) * pitch, (j + dj) * pitch, 0.0]])
                e = Edge(f"{i},{j},{di}", f"{i},{j}", f"{i + di},{j + dj}", p, f"{i},{j},{di}")
                edges += [e, reversed_edge(e)]
    return build_network(edges)


def cpu(work, least: float = 0.3) -> float:
    """CPU seconds of one call, the best of several."""
    work()
    best, spent = np.inf, 0.0
    while spent < least:
        start = time.process_time()
        work()
        took = time.process_time() - start
        best, spent = min(best, took), spent + max(took, 1e-4)
    return best


def density() -> None:
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components, dijkstra

    from fleetlog.analysis.kernels import cluster_steps, reachable

    limit = 15.0
    print(
        "time steps per CPU second, threshold 15 m\nnetwork        trucks  networkx  scipy limit  fleetlog  times faster"
    )
    for name, n in (("200 nodes", grid(20, 10, 6.0)), ("5,000 nodes", grid(100, 50, 20.0))):
        near = reachable(n, float(limit))
        src = np.repeat(np.arange(len(n)), np.diff(n.next_first))
        line = sparse.csr_array((n.length[src], (src, n.next_edges)), shape=(len(n), len(n)))
        graph = nx.from_scipy_sparse_array(line, create_using=nx.DiGraph, edge_attribute="length")
        per = {}
        for trucks in (20, 100, 500):
            rng = np.random.default_rng(trucks)
            steps = 400
            edge = rng.integers(0, len(n), (steps, trucks)).astype(np.int32)
            offset = rng.random((steps, trucks)) * n.length[edge]

            def ours():
                cluster_steps(edge, offset, n.length, *near, limit)

            def theirs_nx(t=0):
                arcs = nx.Graph()
                arcs.add_nodes_from(range(trucks))
                on: dict[int, list[int]] = {}
                for v in range(trucks):
                    on.setdefault(int(edge[t, v]), []).append(v)
                for k in range(trucks):
                    e, rest = int(edge[t, k]), n.length[edge[t, k]] - offset[t, k]
                    arcs.add_edges_from((k, m) for m in on[e] if 0 <= offset[t, m] - offset[t, k] <= limit)
                    reach = nx.single_source_dijkstra_path_length(
                        graph, e, cutoff=limit + offset[t, k], weight="length"
                    )
                    for f, d in reach.items():
                        for m in on.get(f, ()) if f != e else ():
                            if d - n.length[e] + rest + offset[t, m] <= limit:
                                arcs.add_edge(k, m)
                return list(nx.connected_components(arcs))

            def theirs_scipy(t=0):
                d = dijkstra(line, indices=edge[t], limit=limit + float(n.length.max()))
                to = d[:, edge[t]] - offset[t][:, None] + offset[t][None, :]
                return connected_components(
                    sparse.csr_array((to >= 0) & (to <= limit)), directed=True, connection="weak"
                )

            a, b, c = 1 / cpu(theirs_nx), 1 / cpu(theirs_scipy), steps / cpu(ours)
            per[trucks] = c
            print(f"{name:13s} {trucks:7d} {a:9.0f} {b:12.0f} {c:9.0f} {c / max(a, b):13.0f}")
        print(f"{name:13s} a step at 500 trucks costs {per[20] / per[500]:.1f} times one at 20")


def heatmap() -> None:
    from fleetlog.analysis.kernels import accumulate

    n, size = 10_000_000, 1000
    rng = np.random.default_rng(0)
    x, y = (np.clip(np.cumsum(rng.normal(0, 0.5, n)) % size, 0, size - 1e-6) for _ in range(2))
    t = np.arange(n, dtype=np.int64) * 100_000
    bounds = [[0, size], [0, size]]
    step = t, np.ones(n), np.ones(n), 0.2, np.ones(n, np.bool_)
    rows = {
        "fleetlog, six layers": lambda: accumulate(
            x, y, *step, 0.0, 0.0, 1.0, 15.0, size, np.zeros((size * size, 6))
        )
    }
    rows["numpy histogram2d"] = lambda: np.histogram2d(y, x, size, bounds)
    try:
        import boost_histogram as bh

        axis = bh.axis.Regular(size, 0, size)
        rows["boost-histogram"] = lambda: bh.Histogram(axis, axis).fill(y, x)
    except ImportError:
        print("boost-histogram is not installed")
    try:
        import datashader as ds
        import pandas as pd

        frame, canvas = pd.DataFrame({"x": x, "y": y}), ds.Canvas(size, size, (0, size), (0, size))
        rows["datashader"] = lambda: canvas.points(frame, "x", "y", ds.count())
    except ImportError:
        print("datashader is not installed")
    print("10 million rows into 1000 x 1000 cells, CPU s")
    for name, work in rows.items():
        print(f"{name:26s} {cpu(work):.3f}")


def pmedian() -> None:
    from fleetlog.analysis.placement.select import p_median

    rng = np.random.default_rng(1)
    sites, demand, w = rng.random((200, 2)), rng.random((2000, 2)), rng.random(2000)
    d = np.hypot(*(demand[:, None] - sites[None]).transpose(2, 0, 1))
    print("200 candidates, 2,000 demand points\n k  CPU s  mean distance  proven gap")
    for k in (5, 10, 20):
        p_median(w, d, k)
        start = time.process_time()
        got = p_median(w, d, k)
        print(f"{k:2d} {time.process_time() - start:6.2f} {got.objective:14.5f} {got.gap:11.3%}")
    peer()


def peer() -> None:
    """spopt's p-median by CBC on an instance that it settles, beside ours."""
    from fleetlog.analysis.placement.select import p_median

    try:
        import pulp
        from spopt.locate import PMedian
    except ImportError:
        print("spopt is not installed")
        return
    rng = np.random.default_rng(2)
    sites, demand, w = rng.random((40, 2)), rng.random((100, 2)), rng.random(100)
    d = np.hypot(*(demand[:, None] - sites[None]).transpose(2, 0, 1))
    print("40 candidates, 100 demand points\n k  ours: s, mean distance, gap    spopt: s, mean distance")
    for k in (3, 5, 10):
        p_median(w, d, k)
        start = time.perf_counter()
        ours = p_median(w, d, k)
        middle = time.perf_counter()
        model = PMedian.from_cost_matrix(d, w, p_facilities=k).solve(pulp.PULP_CBC_CMD(msg=False))
        end = time.perf_counter()
        theirs = pulp.value(model.problem.objective) / w.sum()
        print(
            f"{k:2d} {middle - start:6.3f} {ours.objective:.6f} {ours.gap:.2%}  {end - middle:12.3f} {theirs:.6f}"
        )


if __name__ == "__main__":
    for name in sys.argv[1:] or ("density", "heatmap", "pmedian"):
        {"density": density, "heatmap": heatmap, "pmedian": pmedian}[name]()
