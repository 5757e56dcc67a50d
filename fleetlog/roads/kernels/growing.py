"""Arrays that grow, by plain loops: numpy's own way costs seconds to compile."""

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def longer(array: Any, size: int) -> Any:
    """A copy of a one-dimensional array with room for ``size`` values; the new ones are not set."""
    out = np.empty(size, array.dtype)
    for i in range(min(len(array), size)):
        out[i] = array[i]
    return out
