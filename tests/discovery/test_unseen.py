"""A load that nobody weighed is the same in all windows of a trip: what is left after it is taken out is independent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.discovery.unseen import amount, shared


@given(st.integers(1, 6), st.integers(1, 9), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_rows_of_a_trip_become_independent(trips: int, rows: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    trip = rng.permutation(np.repeat(np.arange(trips), rows))
    z = 3.0 * rng.normal(size=len(trip))
    together = np.eye(len(trip)) + np.outer(z, z) * (trip[:, None] == trip[None, :])
    half = shared(z, trip).out_of(np.eye(len(trip)))
    assert half @ together @ half.T == pytest.approx(np.eye(len(trip)), abs=1e-9)


def test_the_amount_of_each_trip_is_found() -> None:
    rng = np.random.default_rng(0)
    trip = np.repeat(np.arange(30), 40)
    z, true = rng.uniform(1.0, 4.0, len(trip)), rng.normal(size=30)
    guess = amount(z, z * true[trip] + 0.1 * rng.normal(size=len(trip)), np.full(len(trip), 100.0), trip)
    assert guess == pytest.approx(z * true[trip], abs=0.2)
