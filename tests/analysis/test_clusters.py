"""Density clusters against a plain networkx reading of the rule, and its laws."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.analysis.kernels import cluster_steps, reachable
from fleetlog.core.network import Edge, build_network, reversed_edge


def random_network(seed, nodes=9, two_way=0.5):
    rng = np.random.default_rng(seed)
    p = np.c_[rng.random((nodes, 2)) * 60, np.zeros(nodes)]
    ring = [(i, (i + 1) % nodes) for i in range(nodes)]
    extra = {tuple(rng.choice(nodes, 2, replace=False)) for _ in range(nodes)}
    edges = []
    for i, (a, b) in enumerate([*ring, *sorted(extra - set(ring) - {(b, a) for a, b in ring})]):
        e = Edge(f"r{i}", f"n{a}", f"n{b}", p[[a, b]], f"r{i}")
        edges += [e, reversed_edge(e)] if rng.random() < two_way else [e]
    return build_network(edges)


def trucks(network, seed, steps=5, count=12):
    rng = np.random.default_rng(seed)
    edge = rng.integers(-1, len(network), (steps, count)).astype(np.int32)
    offset = rng.random((steps, count)) * network.length[edge]
    return edge, offset


def labels(network, edge, offset, threshold):
    near = reachable(network, float(threshold))
    return cluster_steps(edge, offset, network.length, *near, threshold)[0]


def line_graph(network):
    """Edge to edge; an arc has the length of the edge that it leaves."""
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(network)))
    for i in range(len(network)):
        graph.add_edges_from(((i, int(j)) for j in network.successors(i)), length=float(network.length[i]))
    return graph


def plain(network, edge, offset, threshold):
    """The rule, word by word."""
    graph = line_graph(network)
    onward = dict(nx.all_pairs_dijkstra_path_length(graph, weight="length"))
    out = np.full(edge.shape, -1)
    for t in range(len(edge)):
        here = [v for v in range(edge.shape[1]) if edge[t, v] >= 0]
        arcs = nx.Graph()
        arcs.add_nodes_from(here)
        for k in here:
            for m in here:
                a, b = int(edge[t, k]), int(edge[t, m])
                ways = [offset[t, m] - offset[t, k]] if a == b and offset[t, m] >= offset[t, k] else []
                for f in network.successors(a):
                    to_start = onward[int(f)].get(b, np.inf)
                    ways.append(network.length[a] - offset[t, k] + to_start + offset[t, m])
                if k != m and min(ways, default=np.inf) <= threshold:
                    arcs.add_edge(k, m)
        for part in nx.connected_components(arcs):
            for v in part:
                out[t, v] = min(part)
    return out


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 60))
def test_identical_to_the_plain_reading(seed, threshold):
    n = random_network(seed)
    edge, offset = trucks(n, seed)
    assert np.array_equal(labels(n, edge, offset, threshold), plain(n, edge, offset, threshold))


def reverse(network):
    edges = [
        Edge(
            network.edge_ids[i],
            network.node_ids[network.end[i]],
            network.node_ids[network.start[i]],
            network.polyline(i)[::-1].copy(),
            network.roads[i],
        )
        for i in range(len(network))
    ]
    turns = [
        (network.edge_ids[j], network.edge_ids[i]) for i in range(len(network)) for j in network.successors(i)
    ]
    return build_network(edges, turns=turns)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 60))
def test_reversing_every_road_changes_nothing(seed, threshold):
    n = random_network(seed)
    edge, offset = trucks(n, seed)
    back = np.where(edge >= 0, n.length[edge] - offset, 0.0)
    # A hair of tolerance: distances are the same sums in another order.
    assert np.array_equal(
        labels(n, edge, offset, threshold), labels(reverse(n), edge, back, threshold + 1e-9)
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 40), st.floats(0, 40))
def test_raising_the_threshold_only_merges(seed, low, more):
    n = random_network(seed)
    edge, offset = trucks(n, seed)
    fine, coarse = labels(n, edge, offset, low), labels(n, edge, offset, low + more)
    for t in range(len(edge)):
        for c in np.unique(fine[t][fine[t] >= 0]):
            assert len(np.unique(coarse[t][fine[t] == c])) == 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 40))
def test_the_order_of_trucks_does_not_matter(seed, threshold):
    n = random_network(seed)
    edge, offset = trucks(n, seed)
    p = np.random.default_rng(seed).permutation(edge.shape[1])
    a, b = labels(n, edge, offset, threshold), labels(n, edge[:, p], offset[:, p], threshold)
    same = lambda q: q[:, :, None] == q[:, None, :]
    assert np.array_equal(same(a)[:, p][:, :, p], same(b))


def test_queue_on_a_one_way_aisle_is_one_cluster_and_the_opposite_lane_is_not():
    a = Edge("a", "s", "e", np.array([[0, 0, 0], [100, 0, 0.0]]), "a")
    b = Edge("b", "e", "s", np.array([[100, 0, 0], [100, 80, 0], [0, 80, 0], [0, 0, 0.0]]), "b")
    n = build_network([a, b])
    edge = np.array([[0, 0, 0, 1]], np.int32)
    offset = np.array([[10.0, 18.0, 27.0, 130.0]])
    assert labels(n, edge, offset, 12.0).tolist() == [[0, 0, 0, 3]]
    two = build_network([a, reversed_edge(a)])
    # 2 m apart on opposite lanes, far apart by road: the U-turn at the junction behind is not implied.
    assert labels(two, np.array([[0, 1]], np.int32), np.array([[50.0, 52.0]]), 15.0).tolist() == [[0, 1]]
    assert labels(two, np.array([[0, 0]], np.int32), np.array([[50.0, 50.0]]), 0.0).tolist() == [[0, 0]]


def test_u_turns_at_vertices_are_not_implied():
    arms = [
        Edge(f"r{i}", "c", f"n{i}", np.array([[0, 0, 0], [10 * np.cos(i), 10 * np.sin(i), 0.0]]), f"r{i}")
        for i in range(3)
    ]
    n = build_network([e for a in arms for e in (a, reversed_edge(a))])
    out, back = n.edge("r0"), n.edge("-r0")
    # Two metres before and two metres behind the junction on opposite lanes: four metres only by a U-turn.
    assert labels(n, np.array([[back, out]], np.int32), np.array([[8.0, 2.0]]), 5.0).tolist() == [[0, 1]]
    assert labels(n, np.array([[back, n.edge("r1")]], np.int32), np.array([[8.0, 2.0]]), 5.0).tolist() == [
        [0, 0]
    ]


def test_distances_are_bounded_dijkstra():
    n = random_network(3, nodes=14)
    begin, count, edges, d = reachable(n, 35.0)
    graph = line_graph(n)
    for i in range(len(n)):
        want = {}
        for f in n.successors(i):
            for j, length in nx.single_source_dijkstra_path_length(graph, int(f), weight="length").items():
                if length <= 35.0:
                    want[j] = min(length, want.get(j, np.inf))
        rows = slice(begin[i], begin[i] + count[i])
        assert dict(zip(edges[rows].tolist(), d[rows], strict=True)) == pytest.approx(want)
        assert (np.diff(d[rows]) >= 0).all()  # nearest first
