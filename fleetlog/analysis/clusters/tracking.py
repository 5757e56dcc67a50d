"""Clusters followed over time: episodes with hysteresis, births, merges and splits.

A cluster at one step continues the cluster of the step before whose members it shares most (Jaccard share of
at least one half; Kalnis, Mamoulis and Bakiras 2005, "moving clusters").  Two disjoint clusters cannot both
share more than half with a third, so taking pairs in order of their share is the maximum-weight matching.
"""

import numpy as np
import pandas as pd

from fleetlog.analysis.clusters.steps import Crowds
from fleetlog.core.arrays import Floats, Ints

LEAVE = 1.2  # A critical cluster stays critical until its mean speed exceeds this multiple of the limit
JACCARD = 0.5


def episodes(c: Crowds, limit: float, step: int, least: int) -> tuple[Ints, pd.DataFrame]:
    """Critical episodes of at least ``least`` steps, in order of their start; ``step`` [us].

    (C,) the episode of every cluster, -1 for none; and a row an episode: its ``first`` and ``last`` cluster,
    how many ``steps`` it lasts, ``max_size``, ``min_mean_speed``, how it was ``born`` and how it ``died``.
    """
    size, time, speed = (c.clusters[name] for name in ("size", "time", "mean_speed"))
    pairs = _overlaps(c, step)
    before, after, common = (pairs[name].to_numpy() for name in pairs)
    parent = _parents(pairs, common / (size[before] + size[after] - common), len(size))
    of = _critical(parent, speed, limit)
    inside = np.flatnonzero(of >= 0)
    each = pd.DataFrame({"cluster": inside, "size": size[inside], "speed": speed[inside]}).groupby(of[inside])
    found = each.agg(
        first=("cluster", "first"), last=("cluster", "last"), steps=("cluster", "size"),
        max_size=("size", "max"), min_mean_speed=("speed", "min"),
    )  # fmt: skip
    swallowed = before[(common == size[before]) & (size[after] > common)]
    ancestors, heirs, absorbed = (np.bincount(v, minlength=len(size)) for v in (after, before, swallowed))
    first, last = found["first"], found["last"]
    split = (ancestors[first] == 1) & (parent[first] < 0)
    found["born"] = np.select([ancestors[first] > 1, split], ["merge", "split"], "born")
    merged = (heirs[last] == 1) & (absorbed[last] > 0)
    found["died"] = np.select([heirs[last] > 1, merged], ["split", "merge"], "died")
    kept = found[found["steps"] >= least]
    kept = kept.iloc[np.lexsort((time[kept["last"]], time[kept["first"]]))]
    number = np.full(len(found) + 1, -1)
    number[kept.index] = np.arange(len(kept))
    return number[of], kept.reset_index(drop=True)


def _critical(parent: Ints, speed: Floats, limit: float) -> Ints:
    """(C,) the episode of every cluster, numbered as they begin, -1 for none."""
    of, begun = np.full(len(parent), -1), 0
    for k, (p, v) in enumerate(zip(parent.tolist(), speed.tolist(), strict=True)):
        before = of[p] if p >= 0 else -1
        if v < (limit if before < 0 else limit * LEAVE):
            of[k] = begun if before < 0 else before
            begun += before < 0
    return of


def _overlaps(c: Crowds, step: int) -> pd.DataFrame:
    """Clusters of one step and the next that share members: ``before``, ``after``, how many in ``common``."""
    cluster, truck, count = c.owner, c.members["truck"], len(c.clusters["size"])
    time = c.clusters["time"][cluster]
    order = np.lexsort((time, truck))
    a, b = order[:-1], order[1:]
    stays = (truck[a] == truck[b]) & (time[b] - time[a] == step)
    key, common = np.unique(cluster[a[stays]] * count + cluster[b[stays]], return_counts=True)
    before, after = np.divmod(key, max(count, 1))
    return pd.DataFrame({"before": before, "after": after, "common": common})


def _parents(pairs: pd.DataFrame, share: Floats, count: int) -> Ints:
    """(C,) the cluster of the step before that each cluster continues, -1 for none."""
    best = pairs.assign(share=-share)[share >= JACCARD].sort_values(["share", "after", "before"])
    matched = best.drop_duplicates("after").drop_duplicates("before")
    out = np.full(count, -1)
    out[matched["after"]] = matched["before"]
    return out
