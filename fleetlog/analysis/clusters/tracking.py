"""Clusters followed over time: episodes with hysteresis, births, merges and splits.

A cluster at one step continues the cluster of the step before whose members it shares most (Jaccard share of
at least one half; Kalnis, Mamoulis and Bakiras 2005, "moving clusters").  Two disjoint clusters cannot both
share more than half with a third, so taking pairs in order of their share is the maximum-weight matching.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetlog.analysis.clusters.steps import Clusters, Fleet

LEAVE = 1.2
"""A critical cluster stays critical until its mean speed exceeds this multiple of the limit."""
JACCARD = 0.5


@dataclass
class Episode:
    """One critical cluster from birth to death;
    steps are row numbers of the time grid, ``members`` truck indices.
    """

    first: int
    last: int
    steps: list[int] = field(default_factory=list)
    members: list[NDArray[np.intp]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    born: str = "born"
    died: str = "died"


@dataclass
class _Live:
    members: frozenset[int]
    episode: Episode | None
    was: str


def episodes(fleet: Fleet, clusters: Clusters, limit: float, min_duration: float) -> list[Episode]:
    """Critical episodes of at least ``min_duration`` seconds, in order of their start."""
    found: list[Episode] = []
    live: list[_Live] = []
    busy = np.flatnonzero((clusters.size >= 2).any(axis=1))
    previous = -2
    for t in busy.tolist():
        if t != previous + 1:
            live = []
        live = _step(t, live, clusters, limit, found)
        previous = t
    least = max(1, round(min_duration / fleet.step))
    return sorted((e for e in found if len(e.steps) >= least), key=lambda e: (e.first, e.last))


def _step(t: int, before: list[_Live], clusters: Clusters, limit: float, found: list[Episode]) -> list[_Live]:
    now = []
    labels = clusters.labels[t]
    for c in np.flatnonzero(clusters.size[t] >= 2).tolist():
        members = np.flatnonzero(labels == c)
        now.append((frozenset(members.tolist()), members, float(clusters.mean_speed[t, c])))
    parents = _match([m for m, _, _ in now], [b.members for b in before])
    out = []
    for i, (member_set, members, speed) in enumerate(now):
        parent = before[parents[i]] if parents[i] >= 0 else None
        episode = parent.episode if parent else None
        if speed < (limit * LEAVE if episode else limit):
            if episode is None:
                overlaps = sum(bool(member_set & b.members) for b in before)
                born = "merge" if overlaps > 1 else "split" if overlaps == 1 and parent is None else "born"
                episode = Episode(t, t, born=born)
                found.append(episode)
            episode.last = t
            episode.steps.append(t)
            episode.members.append(members)
            episode.speeds.append(speed)
        else:
            episode = None
        out.append(_Live(member_set, episode, ""))
    continued = {id(o.episode) for o in out if o.episode}
    for b in before:
        if b.episode and id(b.episode) not in continued:
            heirs = sum(bool(b.members & o.members) for o in out)
            b.episode.died = "split" if heirs > 1 else "merge" if heirs == 1 and _absorbed(b, out) else "died"
    return out


def _absorbed(old: _Live, now: list[_Live]) -> bool:
    return any(old.members < o.members for o in now)


def _match(now: list[frozenset[int]], before: list[frozenset[int]]) -> list[int]:
    """Index of the cluster before that each cluster now continues, -1 for none."""
    pairs = []
    for i, a in enumerate(now):
        for j, b in enumerate(before):
            common = len(a & b)
            if common and common / len(a | b) >= JACCARD:
                pairs.append((-common / len(a | b), i, j))
    parents, taken = [-1] * len(now), set()
    for _, i, j in sorted(pairs):
        if parents[i] < 0 and j not in taken:
            parents[i] = j
            taken.add(j)
    return parents
