"""Weights of windows: noise is judged by what a fit would miss that had not seen the window."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.discovery.linear import _robust_weights
from fleetlog.discovery.windows import Windows


def _windows(count: int) -> Windows:
    zeros, ten = np.zeros(count, np.int64), np.full(count, 10.0)
    return Windows(
        trip=zeros, vehicle=zeros, day=zeros, edge=zeros, duration=ten, distance=10.0 * ten, x=ten, y=ten, time=np.arange(count) * 10.0
    )  # fmt: skip


@pytest.mark.parametrize("columns", [3, 250, 400, 600, 1000])
def test_the_weight_is_one_over_the_noise_however_many_columns_there_are(columns: int) -> None:
    rng = np.random.default_rng(3)
    count, noise = 500, 4.0
    y, x = rng.normal(0.0, noise, count), rng.normal(size=(count, columns)).astype(np.float32)
    level, none = 100.0 + rng.random(count), np.zeros(count)
    weight = _robust_weights(_windows(count), level, y, x, np.ones(count, bool), none, none)
    assert 0.25 < np.median(weight) * noise**2 < 2.0
