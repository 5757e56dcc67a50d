"""Small functions on arrays, against numpy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.arrays import levels


@given(st.lists(st.integers(-(2**62), 2**62)))
def test_levels_are_those_of_numpy(numbers: list[int]) -> None:
    assert levels(np.array(numbers, np.int64)).tolist() == np.unique(numbers).tolist()
