"""The noise floor: what the noise of a recording leaves to a model that is right, estimated without any
candidate.

Windows that are alike (place, direction, load, pace) differ by noise alone.  Half the mean square of the
difference of their residuals, extrapolated to windows that are alike in everything, is its variance (the
gamma test: Stefánsson, Končar and Jones 1997, doi 10.1007/BF01413858).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NEIGHBOURS = 10
FEWEST = 50


def noise_floor(features: Floats, residual: Floats, trip: Ints, wanted: NDArray[np.bool_]) -> float | None:
    """Return the noise in the ``wanted`` windows (root mean square); None with too few windows.

    ``features`` (W, d), ``residual`` (W,), ``trip`` (W,): windows of one trip share its noise and are not
    compared.
    """
    if len(residual) < FEWEST or wanted.sum() < NEIGHBOURS:
        return None
    tree = cKDTree(features)
    distance, near = tree.query(features[wanted], k=min(6 * NEIGHBOURS, len(residual)))
    other = trip[near] != trip[wanted][:, None]
    half = 0.5 * (residual[near] - residual[wanted][:, None]) ** 2
    rank = np.cumsum(other, axis=1)
    use = other & (rank <= NEIGHBOURS)
    if not use.any():
        return None
    delta = np.array(
        [
            np.mean(distance[use & (rank == k)] ** 2)
            for k in range(1, NEIGHBOURS + 1)
            if (use & (rank == k)).any()
        ]
    )
    gamma = np.array(
        [np.mean(half[use & (rank == k)]) for k in range(1, NEIGHBOURS + 1) if (use & (rank == k)).any()]
    )
    slope, start = np.polyfit(delta, gamma, 1) if len(delta) > 2 and np.ptp(delta) > 0 else (0.0, gamma[0])
    nearest = float(gamma[0])
    return float(np.sqrt(np.clip(start if slope > 0 else nearest, 0.25 * nearest, nearest)))
