"""Columns of repeated text under other names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fleetlog.core.trajectory import Labels


def renamed(labels: Labels, names: Sequence[str | None]) -> Labels:
    """The labels with a new name for each of theirs; None is null, and equal names become one."""
    if list(names) == list(labels.names):
        return labels
    fresh = Labels.of(names)
    return Labels(np.append(fresh.codes, np.int32(-1))[labels.codes], fresh.names)
