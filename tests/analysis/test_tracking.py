"""Episodes followed in pieces and joined are those followed in one go, wherever the hours are cut."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.analysis.clusters.crowds import Crowds, together
from fleetlog.analysis.clusters.tracking import episodes, follow

LIMIT, STEP, TRUCKS = 1.0, 1_000_000, 6
NAMES = tuple(f"T{k}" for k in range(TRUCKS))


def crowds(steps):
    """Steps of (time, groups of trucks with a speed each)."""
    rows = [(t, k, sorted(group), v) for t, groups in steps for k, (group, v) in enumerate(groups)]
    size = [len(g) for _, _, g, _ in rows]
    truck = np.array([m for _, _, g, _ in rows for m in g], np.int64)
    none, members = np.zeros(0), len(truck)
    return Crowds(
        NAMES, np.array([t * STEP for t, *_ in rows], np.int64), np.array([k for _, k, *_ in rows], np.int64),
        np.array([v for *_, v in rows]), np.zeros(len(rows)), np.concatenate([[0], np.cumsum(size)]).astype(np.int64),
        truck, np.zeros(members, np.int32), np.zeros(members), np.zeros(members), none.astype(np.int64),
        np.zeros((0, 2, 2)), none.astype(bool), {}, len(steps),
    )  # fmt: skip


def found(pieces):
    whole = together(pieces, NAMES)
    begins = np.cumsum([0, *map(len, pieces)]).tolist()
    parts = [(b, follow(p, LIMIT, STEP)) for b, p in zip(begins, pieces, strict=False)]
    return [(e.clusters, e.born, e.died) for e in episodes(whole, parts, LIMIT, STEP, 1)]


@st.composite
def histories(draw):
    """Trucks that form, keep and change groups, at speeds on both sides of both limits; steps without any between."""
    steps, time, groups = [], 0, None
    for _ in range(draw(st.integers(1, 25))):
        time += draw(st.sampled_from([1, 1, 1, 1, 3]))
        if groups is None or draw(st.integers(0, 2)) == 0:
            of = draw(st.lists(st.integers(0, 3), min_size=TRUCKS, max_size=TRUCKS))
            groups = [{m for m in range(TRUCKS) if of[m] == k} for k in range(3)]
        several = [g for g in groups if len(g) > 1]
        speeds = draw(st.lists(st.sampled_from([0.5, 1.1, 1.5]), min_size=3, max_size=3))
        if several:
            steps.append((time, list(zip(several, speeds, strict=False))))
    return steps


@given(histories(), st.sets(st.integers(1, 60), max_size=4))
def test_where_hours_are_cut_makes_no_difference(steps, cuts):
    edges = [0, *sorted(cuts), 100]
    pieces = [[s for s in steps if a <= s[0] < b] for a, b in pairwise(edges)]
    assert found([crowds(p) for p in pieces]) == found([crowds(steps)])
