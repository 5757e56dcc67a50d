"""Clusters followed over time: episodes with hysteresis, births, merges and splits.

A cluster at one step continues the cluster of the step before whose members it shares most (Jaccard share of
at least one half; Kalnis, Mamoulis and Bakiras 2005, "moving clusters").  Two disjoint clusters cannot both
share more than half with a third, so taking pairs in order of their share is the maximum-weight matching.

Hours are followed apart (:func:`follow`), each as if nothing had been before it, and joined
(:func:`episodes`): the first steps of an hour are followed again from what the hour before left, until the
same clusters are critical as were found without it; from there on nothing can differ.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fleetlog.analysis.clusters.crowds import Crowds
from fleetlog.core.trajectory import Ints

LEAVE = 1.2
"""A critical cluster stays critical until its mean speed exceeds this multiple of the limit."""
JACCARD = 0.5


@dataclass
class Episode:
    """One critical cluster from birth to death: its clusters, one a step."""

    clusters: list[int] = field(default_factory=list)
    born: str = "born"
    died: str = "died"


@dataclass(frozen=True)
class Followed:
    """Episodes of some hours: (C,) that of each cluster, -1 for none; how each began and ended."""

    episode: Ints
    born: list[str]
    died: list[str]


class Live(NamedTuple):
    """A cluster of the last step, and the episode that is open in it."""

    cluster: int
    members: frozenset[int]
    episode: Episode | None


class Step(NamedTuple):
    """The clusters of one time step, from ``first`` to before ``last``."""

    first: int
    last: int
    follows: bool
    """Whether the step before has clusters too."""


def steps_of(time: Ints, step: int, before: int | None = None) -> Iterator[Step]:
    """The steps with clusters; ``before`` is the time of the last one before them."""
    begins = np.flatnonzero(np.diff(time, prepend=time[:1] - 1)).tolist()
    for a, b in itertools.pairwise([*begins, len(time)]):
        now = int(time[a])
        yield Step(a, b, before is not None and now - before == step)
        before = now


def follow(c: Crowds, limit: float, step: int) -> Followed:
    """Follow the clusters of some hours by themselves."""
    found: list[Episode] = []
    live: list[Live] = []
    for s in steps_of(c.time, step):
        live = _advance(live if s.follows else [], s, c, limit, found)
    number = np.full(len(c), -1, np.int64)
    for k, episode in enumerate(found):
        number[episode.clusters] = k
    return Followed(number, [e.born for e in found], [e.died for e in found])


def episodes(
    whole: Crowds, pieces: Sequence[tuple[int, Followed]], limit: float, step: int, least: int
) -> list[Episode]:
    """Critical episodes of at least ``least`` steps, in order of their start.

    ``pieces`` are the hours: the first cluster of each in ``whole``, and what was found in it alone.
    """
    found: list[Episode] = []
    live: list[Live] = []
    before: int | None = None
    for first, piece in pieces:
        last = first + len(piece.episode)
        if first == last:
            continue
        alone = steps_of(whole.time[first:last], step, before)
        steps = [Step(s.first + first, s.last + first, s.follows) for s in alone]
        live, rest = _replay(live, steps, piece, first, whole, limit, found)
        live = _splice(live, rest, piece, first, last, whole, found)
        before = int(whole.time[last - 1])
    time = whole.time
    enough = [e for e in found if len(e.clusters) >= least]
    return sorted(enough, key=lambda e: (time[e.clusters[0]], time[e.clusters[-1]]))


def _replay(
    live: list[Live], steps: list[Step], piece: Followed, base: int, c: Crowds, limit: float,
    found: list[Episode],
) -> tuple[list[Live], int]:  # fmt: skip
    """Follow from what was before until the piece says the same; what is live then, and the next cluster."""
    for s in steps:
        live = _advance(live if s.follows else [], s, c, limit, found)
        if all((now.episode is not None) == (piece.episode[now.cluster - base] >= 0) for now in live):
            return live, s.last
    return live, steps[-1].last


def _splice(
    live: list[Live], rest: int, piece: Followed, base: int, last: int, c: Crowds, found: list[Episode]
) -> list[Live]:
    """Take the clusters from ``rest`` on from the piece; what is live at its end."""
    known = {int(piece.episode[n.cluster - base]): n.episode for n in live if n.episode is not None}
    numbers = piece.episode[rest - base :]
    inside = np.flatnonzero(numbers >= 0)
    order = inside[np.argsort(numbers[inside], kind="stable")]
    for k, clusters in _grouped(numbers[order], order + rest):
        episode = known.get(k)
        if episode is None:
            episode = known[k] = Episode(born=piece.born[k])
            found.append(episode)
        episode.clusters += clusters
    for k, episode in known.items():
        if k >= 0 and episode is not None:
            episode.died = piece.died[k]
    if rest == last:
        return live
    final = np.flatnonzero(c.time[rest:last] == c.time[last - 1]) + rest
    return [Live(k, _members(c, k), known.get(int(piece.episode[k - base]))) for k in final.tolist()]


def _grouped(keys: Ints, values: Ints) -> Iterator[tuple[int, list[int]]]:
    cuts = np.flatnonzero(np.diff(keys)) + 1
    for part in np.split(np.arange(len(keys)), cuts) if len(keys) else ():
        yield int(keys[part[0]]), values[part].tolist()


def _members(c: Crowds, cluster: int) -> frozenset[int]:
    return frozenset(c.truck[c.members(cluster)].tolist())


def _advance(before: list[Live], s: Step, c: Crowds, limit: float, found: list[Episode]) -> list[Live]:
    """The clusters of a step, each with the episode that it goes on with or begins."""
    now = [(k, _members(c, k)) for k in range(s.first, s.last)]
    parents = _match([m for _, m in now], [b.members for b in before])
    out = []
    for (k, members), p in zip(now, parents, strict=True):
        episode = before[p].episode if p >= 0 else None
        critical = c.mean_speed[k] < (limit * LEAVE if episode else limit)
        if critical and episode is None:
            episode = Episode(born=_birth(members, before, p))
            found.append(episode)
        if critical and episode is not None:
            episode.clusters.append(k)
        out.append(Live(k, members, episode if critical else None))
    _end(before, out)
    return out


def _birth(members: frozenset[int], before: list[Live], parent: int) -> str:
    overlaps = sum(bool(members & b.members) for b in before)
    return "merge" if overlaps > 1 else "split" if overlaps == 1 and parent < 0 else "born"


def _end(before: list[Live], now: list[Live]) -> None:
    """Say how the episodes ended that do not go on."""
    continued = {id(o.episode) for o in now if o.episode}
    for b in before:
        if b.episode and id(b.episode) not in continued:
            heirs = sum(bool(b.members & o.members) for o in now)
            absorbed = heirs == 1 and any(b.members < o.members for o in now)
            b.episode.died = "split" if heirs > 1 else "merge" if absorbed else "died"


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
