"""Names of the arrays and tables that signatures speak of; their docstrings say what is in them."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from pandas import DataFrame as DataFrame
else:
    DataFrame = Any  # pandas is loaded where a table is made or read

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Index = NDArray[np.int32]  # Codes and indices, which need less room
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]  # Indices as numpy itself gives them
Array = NDArray[Any]  # Of any kind

HOUR, DAY = 3_600_000_000, 86_400_000_000  # In the unit of all times [us]


def microseconds(text: str) -> int:
    """Return a date or a time of UTC, ``2026-01-05`` or ``2026-01-05T06:00:00Z``, in us since 1970."""
    return int(np.datetime64(text.removesuffix("Z"), "us").astype(np.int64))


def distinct(values: Floats) -> Floats:
    """(N,) values; (1,) where they are one value repeated in place, of which a function is called once."""
    return values[:1] if values.strides == (0,) else values


def levels(numbers: ArrayLike) -> Any:
    """(M,) the different numbers among some, in order. ``np.unique`` hashes whole numbers, which takes many
    times as long as to sort them where most differ (NumPy 2.4)."""
    ordered = np.sort(np.asarray(numbers), axis=None)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])[: len(ordered)]]
