"""Where two heat maps differ by more than chance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetlog.analysis.occupancy.maps import HeatMap
from fleetlog.core.trajectory import Floats


def difference(a: HeatMap, b: HeatMap, seed: int = 0, draws: int = 400) -> tuple[Floats, NDArray[np.bool_]]:
    """Share of time per cell, a minus b, and where it is significant.

    Each unit (vehicle-day) of either map is resampled whole; a cell counts where its difference lies outside
    what pooled resampling gives, two-sided 5 % after Benjamini and Hochberg over all cells that were ever
    visited.
    """
    shares = [m.grid[0] / max(m.grid[0].sum(), 1e-12) for m in (a, b)]
    observed = shares[0] - shares[1]
    units = [(cell, time) for cell, time in (*a.units, *b.units) if len(cell)]
    seen = np.unique(np.concatenate([cell for cell, _ in units]))
    flat = np.zeros((len(units), len(seen)))
    for row, (cell, time) in zip(flat, units, strict=True):
        row[np.searchsorted(seen, cell)] = time / time.sum()
    rng = np.random.default_rng(seed)
    na, nb = max(len(a.units), 1), max(len(b.units), 1)
    null = np.array([
        flat[rng.integers(0, len(flat), na)].mean(axis=0) - flat[rng.integers(0, len(flat), nb)].mean(axis=0)
        for _ in range(draws)
    ])  # fmt: skip
    from scipy.stats import false_discovery_control, norm

    z = np.abs(observed.ravel()[seen]) / np.maximum(null.std(axis=0), 1e-12)
    mask = np.zeros(observed.size, np.bool_)
    mask[seen] = false_discovery_control(2 * norm.sf(z)) <= 0.05
    return observed, mask.reshape(observed.shape)
