"""Routes against networkx on random networks with one-way roads and forbidden turns."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.errors import DataError
from fleetlog.roads.routing import Router


def random_network(seed, nodes=12, roads=24):
    """A network with one-way roads, forbidden turns, detours and several limits; straight roads between their nodes."""
    rng = np.random.default_rng(seed)
    spots = np.column_stack([rng.uniform(0, 100, (nodes, 2)), np.zeros(nodes)])
    edges = []
    for k in range(roads):
        a, b = rng.choice(nodes, 2, replace=False)
        points = np.vstack(
            [spots[a], spots[b]] if rng.random() < 0.5 else [spots[a], spots[a] + [7, 3, 0], spots[b]]
        )
        edge = Edge(f"e{k}", f"n{a}", f"n{b}", points, f"e{k}", rng.choice([2.0, 4.0, np.nan]))
        edges += [edge] if rng.random() < 0.4 else [edge, reversed_edge(edge)]
    pairs = [(a.id, b.id) for a in edges for b in edges if a.end == b.start]
    forbidden = [p for p in pairs if rng.random() < 0.2]
    return build_network(edges, forbidden=forbidden)


def graph(network, weight, closed=()):
    """Line graph whose arc i to j costs driving edge i."""
    out = nx.DiGraph()
    out.add_nodes_from(range(len(network)))
    for i in range(len(network)):
        out.add_edges_from(
            (i, int(j), {"w": weight[i]}) for j in network.successors(i) if int(j) not in closed
        )
    return out


seeds = st.integers(0, 10_000)


@given(seeds)
@settings(deadline=None, max_examples=40)
def test_a_star_is_as_quick_as_dijkstra(seed):
    network = random_network(seed)
    rng = np.random.default_rng(seed)
    closed = {int(c) for c in rng.choice(len(network), 3, replace=False)}
    router = Router(network, np.full(len(network), 3.0))
    reference = graph(network, router.time, closed)
    for source in range(0, len(network), 5):
        best = nx.single_source_dijkstra_path_length(reference, source, weight="w")
        for target in range(len(network)):
            route = router.route(source, target, closed)
            if target not in best:
                assert route is None
                continue
            assert route.cost == pytest.approx(best[target] + router.time[target])
            assert route.edges[0] == source and route.edges[-1] == target
            assert all(b in network.successors(a) for a, b in zip(route.edges, route.edges[1:], strict=False))
            assert not closed & set(route.edges[1:].tolist())
            assert route.length == pytest.approx(network.length[route.edges].sum())


@given(seeds)
@settings(deadline=None, max_examples=25)
def test_reversing_every_road_reverses_every_route(seed):
    network = random_network(seed)
    n = len(network)
    back = [
        Edge(
            network.edge_ids[i], network.node_ids[network.end[i]], network.node_ids[network.start[i]],
            network.polyline(i)[::-1], network.edge_ids[i], network.speed_limit[i],
        )
        for i in range(n)
    ]  # fmt: skip
    turns = [(network.edge_ids[int(j)], network.edge_ids[i]) for i in range(n) for j in network.successors(i)]
    there, again = Router(network), Router(build_network(back, turns))
    for source, target in [(0, n - 1), (n - 1, 0), (1, n // 2)]:
        a, b = there.route(source, target), again.route(target, source)
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert a.cost == pytest.approx(b.cost)


#   +--b--+
#   a     d      two ways of the same length
#   +--c--+
def equal_ways(order):
    far = {"b": (5.0, 5.0), "c": (5.0, -5.0)}
    edges = [Edge("a", "0", "1", np.array([[-9.0, 0, 0], [0, 0, 0]]), "a")]
    edges += [Edge(k, "1", "2", np.array([[0, 0, 0], [*far[k], 0], [10, 0, 0]]), k) for k in order]
    return build_network([*edges, Edge("d", "2", "3", np.array([[10.0, 0, 0], [19, 0, 0]]), "d")])


@pytest.mark.parametrize("order", ["bc", "cb"])
def test_of_two_equal_ways_the_first_in_the_map_is_taken(order):
    network = equal_ways(order)
    route = Router(network).route(network.edge("a"), network.edge("d"))
    assert [network.edge_ids[i] for i in route.edges] == ["a", order[0], "d"]


def test_a_route_to_the_edge_itself_is_that_edge():
    network = equal_ways("bc")
    route = Router(network, np.full(len(network), 3.0)).route(0, 0)
    assert list(route.edges) == [0] and route.cost == pytest.approx(3.0)


def test_turning_costs_time_where_asked():
    # Straight on is longer than the two right angles, and quicker as soon as turning takes time.
    def edge(name, start, end, *points):
        return Edge(name, start, end, np.array([(*p, 0.0) for p in points]), name, 1.0)

    network = build_network([
        edge("in", "0", "1", (-5, 0), (0, 0)),
        edge("bent", "1", "2", (0, 0), (0, 1), (9, 1), (9, 0)),
        edge("straight", "1", "2", (0, 0), (4, 0), (4, 0.5), (4, -2), (5, 0), (9, 0)),
        edge("out", "2", "3", (9, 0), (15, 0)),
    ])  # fmt: skip
    assert network.length[1] < network.length[2]
    quick, careful = Router(network).route(0, 3), Router(network, turn_time=10.0).route(0, 3)
    assert quick.edges[1] == 1 and careful.edges[1] == 2


def test_a_limit_that_is_lowered_lengthens_the_time_of_routes_over_it():
    network = equal_ways("bc")
    slow = np.array([5.0, 1.0, 5.0, 5.0])
    route = Router(network, slow).route(0, 3)
    assert network.edge_ids[route.edges[1]] == "c"


def test_an_edge_that_is_not_there():
    with pytest.raises(DataError, match="no edge with the number 99"):
        Router(equal_ways("bc")).route(0, 99)
