"""Episodes found at once are those of a plain reading, step by step, and hours that are joined change none."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.analysis.clusters.episodes import JACCARD, LEAVE, episodes
from fleetlog.analysis.clusters.steps import Crowds, together

LIMIT, STEP, TRUCKS = 1.0, 1_000_000, 6
NAMES = tuple(f"T{k}" for k in range(TRUCKS))


def crowds(steps):
    """Steps of (time, groups of trucks with a speed each)."""
    rows = [(t, k, sorted(group), v) for t, groups in steps for k, (group, v) in enumerate(groups)]
    size = [len(g) for _, _, g, _ in rows]
    truck = np.array([m for _, _, g, _ in rows for m in g], np.int64)
    none, members = np.zeros(0), len(truck)
    clusters = {
        "time": np.array([t * STEP for t, *_ in rows], np.int64), "size": np.array(size, np.int64),
        "label": np.array([k for _, k, *_ in rows], np.int64), "mean_speed": np.array([v for *_, v in rows]),
        "slow_share": np.zeros(len(rows)),
    }  # fmt: skip
    of = {
        "truck": truck,
        "edge": np.zeros(members, np.int32),
        "offset": np.zeros(members),
        "speed": np.zeros(members),
    }
    arcs = {"time": none.astype(np.int64), "ends": np.zeros((0, 2, 2)), "critical": none.astype(bool)}
    return Crowds(NAMES, clusters, of, arcs, np.zeros((2, 7)), len(steps))


def found(*pieces):
    episode, table = episodes(together(pieces, NAMES), LIMIT, STEP, 1)
    clusters = [np.flatnonzero(episode == k).tolist() for k in range(len(table))]
    return list(zip(clusters, table["born"], table["died"], strict=True))


def plain(steps):
    """The rule, word by word."""
    out, live, before, number = [], [], None, 0
    for time, groups in steps:
        if before is None or time - before != 1:
            live = []
        shares = sorted(
            (-len(g & b) / len(g | b), i, j)
            for i, (g, _) in enumerate(groups) for j, (b, _) in enumerate(live) if g & b
        )  # fmt: skip
        parent = {}
        for share, i, j in shares:
            if -share >= JACCARD and i not in parent and j not in parent.values():
                parent[i] = j
        now = []
        for i, (g, speed) in enumerate(groups):
            episode = live[parent[i]][1] if i in parent else None
            if speed >= (LIMIT * LEAVE if episode else LIMIT):
                episode = None
            elif episode is None:
                heirs = sum(bool(g & b) for b, _ in live)
                born = "merge" if heirs > 1 else "split" if heirs == 1 and i not in parent else "born"
                episode = [[], born, "died"]
                out.append(episode)
            if episode:
                episode[0].append(number)
            now.append((g, episode))
            number += 1
        going = [id(e) for _, e in now if e]
        for b, episode in live:
            if episode and id(episode) not in going:
                heirs = [g for g, _ in now if g & b]
                episode[2] = (
                    "split" if len(heirs) > 1 else "merge" if len(heirs) == 1 and b < heirs[0] else "died"
                )
        live, before = now, time
    return sorted(map(tuple, out), key=lambda e: e[0])


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


@given(histories())
def test_episodes_are_those_of_the_plain_reading(steps):
    assert sorted(found(crowds(steps)), key=lambda e: e[0]) == plain(steps)


@given(histories(), st.sets(st.integers(1, 60), max_size=4))
def test_where_hours_are_cut_makes_no_difference(steps, cuts):
    edges = [0, *sorted(cuts), 100]
    pieces = [[s for s in steps if a <= s[0] < b] for a, b in pairwise(edges)]
    assert found(*map(crowds, pieces)) == found(crowds(steps))
