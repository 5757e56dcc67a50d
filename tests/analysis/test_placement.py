"""Charger placement against worked numbers, proven identities, brute force and networkx."""

from itertools import combinations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from fleetlog.analysis.placement.plan import (
    flow_counts,
    link_matrix,
    peak,
    rank,
    urgency,
    visit_share,
    vote_scores,
)
from fleetlog.analysis.placement.select import cover, p_median, spaced, top_k

from .toy import NAMES, RUNS, distances, visits

HEAT = [0.07463, 0.22388, 0.14925, 0.19403, 0.20896, 0.05970, 0.04478, 0.04478]
RANK = {
    0.50: [0.09258, 0.18051, 0.12267, 0.18646, 0.16701, 0.08636, 0.08039, 0.08401],
    0.85: [0.07942, 0.21415, 0.14010, 0.19559, 0.19377, 0.06581, 0.05404, 0.05712],
    0.99: [0.07495, 0.22334, 0.14865, 0.19419, 0.20786, 0.06004, 0.04535, 0.04562],
}
VOTE = [0.1194, 0.1758, 0.1362, 0.1569, 0.1343, 0.0887, 0.1003, 0.0886]
URGENT = [0.0, 0.13725, 0.13725, 0.27451, 0.19608, 0.05882, 0.05882, 0.13725]
RANK_URGENT = [0.06084, 0.21471, 0.14226, 0.21781, 0.19889, 0.05713, 0.04505, 0.06331]


def names(choice):
    return "".join(NAMES[i] for i in choice.sites)


@pytest.fixture(scope="module")
def counts():
    return flow_counts(visits(), 8)


def test_heat_share_of_the_worked_example():
    assert visit_share(visits(), 8) == pytest.approx(HEAT, abs=5e-6)


@pytest.mark.parametrize("alpha", RANK)
def test_rank_of_the_worked_example(counts, alpha):
    assert rank(counts, alpha) == pytest.approx(RANK[alpha], abs=5e-6)


def test_votes_of_the_worked_example():
    assert vote_scores(visit_share(visits(), 8), distances(), 30.0) == pytest.approx(VOTE, abs=5e-5)


def test_urgency_as_teleport(counts):
    u = [(run, times, float(urgency(np.array([soc]))[0])) for run, times, soc in RUNS]
    w = np.zeros(8)
    for run, times, value in u:
        for c in run[1:]:
            w[NAMES.index(c)] += times * value
    assert w / w.sum() == pytest.approx(URGENT, abs=5e-6)
    assert rank(counts, 0.85, w) == pytest.approx(RANK_URGENT, abs=5e-6)
    assert names(p_median(w, distances(), 2)) == "CD"
    assert p_median(w, distances(), 2).objective == pytest.approx(17.2549, abs=5e-5)


def test_dangling_vertices_keep_the_mass(counts):
    cut = counts.toarray()
    cut[6] = 0
    r = rank(sparse.csr_array(cut))
    assert r == pytest.approx(
        [0.08318, 0.20346, 0.14083, 0.16399, 0.21037, 0.07662, 0.06385, 0.05770], abs=5e-6
    )
    graph = nx.from_numpy_array(cut, create_using=nx.DiGraph)
    theirs = nx.pagerank(graph, alpha=0.85, tol=1e-15, max_iter=1000)
    assert r == pytest.approx([theirs[i] for i in range(8)], abs=1e-12)


def test_selection_of_the_worked_example(counts):
    r, h, d = rank(counts), visit_share(visits(), 8), distances()
    assert names(top_k(r, 2)) == "BD" and names(top_k(h, 2)) == "BE"
    s = spaced(r, d, 2, 40.0)
    assert names(s) == "BE" and s.objective == pytest.approx(0.40792, abs=5e-6)
    m = p_median(r, d, 2)
    assert names(m) == "BE" and m.objective == pytest.approx(18.5487, abs=5e-5) and m.gap == 0
    assert p_median(h, d, 2).objective == pytest.approx(17.4627, abs=5e-5)
    c = cover(r, d, 2, 30.0)
    assert names(c) == "BE" and c.objective == pytest.approx(0.88884, abs=5e-6)
    # B and E forbidden apart from one: {B,D} 21.4925 ties with {C,D} under heat; the smaller numbers win.
    tie = p_median(h, d, 2, forbidden=np.array([NAMES.index("E")]))
    assert tie.objective == pytest.approx(21.4925, abs=5e-5) and names(tie) == "BD"


@given(st.integers(3, 12), st.integers(0, 10_000))
def test_on_closed_trips_the_flow_rank_is_the_heat_share(n, seed):
    rng = np.random.default_rng(seed)
    trips = []
    for _ in range(6):
        loop = rng.integers(0, n, rng.integers(2, 9))
        trips.append(np.r_[loop, loop[0]])
    trips.append(np.r_[np.arange(n), 0])  # everything connected
    c, h = flow_counts(trips, n), visit_share(trips, n)
    m = link_matrix(c)
    assert np.allclose(m.sum(axis=0), 1.0) and np.allclose(m @ h, h)
    for alpha in (0.3, 0.85, 0.99):
        assert np.allclose(rank(c, alpha, h), h, atol=1e-9)


@given(st.floats(1e-3, 1e3), st.integers(0, 999))
def test_urgency_scaling_changes_nothing(factor, seed):
    rng = np.random.default_rng(seed)
    w, d = rng.random(8), distances()
    assert np.array_equal(p_median(w, d, 3).sites, p_median(factor * w, d, 3).sites)
    assert np.allclose(
        rank(flow_counts(visits(), 8), 0.85, w), rank(flow_counts(visits(), 8), 0.85, factor * w)
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(4, 11), st.integers(1, 3))
def test_p_median_is_the_best_of_all(seed, n, k):
    rng = np.random.default_rng(seed)
    d, w = rng.random((15, n)) * 100, rng.random(15)
    best = min(np.average(d[:, list(s)].min(axis=1), weights=w) for s in combinations(range(n), k))
    got = p_median(w, d, k)
    assert got.objective == pytest.approx(best, rel=1e-9) and got.gap == 0
    forced = p_median(w, d, k, forced=np.array([n - 1]))
    best = min(
        np.average(d[:, list(s)].min(axis=1), weights=w) for s in combinations(range(n), k) if n - 1 in s
    )
    assert n - 1 in forced.sites and forced.objective == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_interchange_and_bound_agree_with_an_integer_program(seed):
    from fleetlog.analysis.placement.select import _program

    rng = np.random.default_rng(seed)
    d, w = np.hypot(*(rng.random((2, 60, 1)) - rng.random((2, 1, 25)))), rng.random(60)
    best = _program(w[:, None] * d / w.sum(), 4, np.zeros(25, bool))
    got = p_median(w, d, 4)
    assert got.objective == pytest.approx(best.fun, rel=1e-9)
    assert np.array_equal(got.sites, np.flatnonzero(best.x[:25] > 0.5))


def test_large_instances_state_a_small_proven_gap():
    rng = np.random.default_rng(5)
    sites, people = rng.random((200, 2)), rng.random((2000, 2))
    d = np.hypot(*(people[:, None] - sites[None]).transpose(2, 0, 1))
    for k in (5, 10, 20):
        got = p_median(rng.random(2000), d, k)
        assert 0 <= got.gap < 0.02


def test_plugs_at_the_peak():
    assert peak([(0, 0, 10), (1, 5, 8), (0, 8, 12), (0, 20, 30)]) == 2
    assert peak([]) == 0


@pytest.mark.filterwarnings("ignore::DeprecationWarning:pulp.*")
@pytest.mark.parametrize("k", [2, 4, 7])
def test_spopt_finds_nothing_better(k):
    pulp = pytest.importorskip("pulp")
    locate = pytest.importorskip("spopt.locate")
    rng = np.random.default_rng(k)
    sites, demand, w = rng.random((25, 2)), rng.random((60, 2)), rng.random(60)
    d = np.hypot(*(demand[:, None] - sites[None]).transpose(2, 0, 1))
    model = locate.PMedian.from_cost_matrix(d, w, p_facilities=k).solve(pulp.PULP_CBC_CMD(msg=False))
    ours = p_median(w, d, k)
    assert ours.gap == 0 and ours.objective == pytest.approx(
        pulp.value(model.problem.objective) / w.sum(), rel=1e-6
    )
