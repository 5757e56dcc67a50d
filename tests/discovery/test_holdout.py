"""What is kept back is whole: vehicles, days."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.discovery import splits
from fleetlog.discovery.windows import Windows


def windows(vehicles: int, days: int) -> Windows:
    """Forty trips of ten windows on every vehicle-day."""
    v, d, t = (
        a.ravel() for a in np.meshgrid(np.arange(vehicles), np.arange(days), np.arange(400), indexing="ij")
    )
    trip = (v * days + d) * 40 + t // 10
    time = d * 86400.0 + t * 10.0
    n = len(v)
    return Windows(trip, v, d, np.zeros(n, int), np.full(n, 10.0), np.full(n, 20.0), time, time, time)


@pytest.mark.parametrize(("vehicles", "days"), [(2, 2), (3, 1), (4, 5), (10, 3), (1, 7)])
@pytest.mark.parametrize("holdout", ["vehicles", "days"])
def test_what_is_kept_back_is_whole(vehicles: int, days: int, holdout: str) -> None:
    w = windows(vehicles, days)
    unit, count = (w.vehicle, vehicles) if holdout == "vehicles" else (w.day, days)
    test = splits.test_windows(w, holdout, np.random.default_rng(0))
    assert 0 < test.sum() < len(w)
    if count > 1:
        assert not set(unit[test]) & set(unit[~test])
    else:
        assert not set(splits.slow_blocks(w)[test]) & set(splits.slow_blocks(w)[~test])
