"""Clusters followed over time: episodes with hysteresis, births, merges and splits.

A cluster at one step continues the cluster of the step before whose members it shares most (Jaccard share of
at least one half; Kalnis, Mamoulis and Bakiras 2005, "moving clusters").  Two disjoint clusters cannot both
share more than half with a third, so taking pairs in order of their share is the maximum-weight matching.
"""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from fleetlog.analysis.clusters.crowds import Crowds
from fleetlog.core.trajectory import Ints

LEAVE = 1.2  # A critical cluster stays critical until its mean speed exceeds this multiple of the limit
JACCARD = 0.5


@dataclass
class Episode:
    """One critical cluster from birth to death: its clusters, one a step."""

    born: str
    clusters: list[int] = field(default_factory=list)
    died: str = "died"


def episodes(c: Crowds, limit: float, step: int, least: int) -> list[Episode]:
    """Critical episodes of at least ``least`` steps, in order of their start; ``step`` [us]."""
    pairs = _overlaps(c, step)
    parent, ancestors, heirs = _parents(c, pairs), _count(c, pairs["after"]), _count(c, pairs["before"])
    whole = pairs["common"] == c.size[pairs["before"]]
    absorbed = _count(c, pairs["before"][whole & (c.size[pairs["after"]] > pairs["common"])])
    found: list[Episode] = []
    of: list[Episode | None] = [None] * len(c)
    for k, (p, speed) in enumerate(zip(parent.tolist(), c.mean_speed.tolist(), strict=True)):
        episode = of[p] if p >= 0 else None
        if speed < (limit if episode is None else limit * LEAVE):
            if episode is None:
                split = ancestors[k] == 1 and p < 0
                episode = Episode("merge" if ancestors[k] > 1 else "split" if split else "born")
                found.append(episode)
            episode.clusters.append(k)
            of[k] = episode
    for episode in found:
        last = episode.clusters[-1]
        merged = heirs[last] == 1 and absorbed[last]
        episode.died = "split" if heirs[last] > 1 else "merge" if merged else "died"
    enough = [e for e in found if len(e.clusters) >= least]
    return sorted(enough, key=lambda e: (c.time[e.clusters[0]], c.time[e.clusters[-1]]))


def _overlaps(c: Crowds, step: int) -> pd.DataFrame:
    """Clusters of one step and the next that share members: ``before``, ``after``, how many in ``common``."""
    cluster = np.repeat(np.arange(len(c)), c.size)
    time = c.time[cluster]
    order = np.lexsort((time, c.truck))
    a, b = order[:-1], order[1:]
    stays = (c.truck[a] == c.truck[b]) & (time[b] - time[a] == step)
    key, common = np.unique(cluster[a[stays]] * len(c) + cluster[b[stays]], return_counts=True)
    before, after = np.divmod(key, max(len(c), 1))
    return pd.DataFrame({"before": before, "after": after, "common": common})


def _parents(c: Crowds, pairs: pd.DataFrame) -> Ints:
    """(C,) the cluster of the step before that each cluster continues, -1 for none."""
    union = c.size[pairs["before"]] + c.size[pairs["after"]] - pairs["common"]
    share = pairs["common"] / union
    best = pairs.assign(share=-share)[share >= JACCARD].sort_values(["share", "after", "before"])
    matched = best.drop_duplicates("after").drop_duplicates("before")
    out = np.full(len(c), -1, np.int64)
    out[matched["after"]] = matched["before"]
    return out


def _count(c: Crowds, clusters: pd.Series) -> Ints:
    return np.bincount(clusters, minlength=len(c))
