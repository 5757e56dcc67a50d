"""A floor on one-way roads rolls hard, or they climb: energy cannot tell, and the diagnosis says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from degrade import diagnosed
from plants import Plant
from recorder import record


@pytest.mark.slow
@pytest.mark.parametrize(("oneway", "seed"), [(True, 51), (True, 53), (False, 51)])
def test_slope_and_floor_are_told_apart_where_both_directions_are_driven(
    oneway: bool, seed: int, tmp_path: Path
) -> None:
    plant = Plant(np.random.default_rng(seed))
    roads = [int(k) for k in np.flatnonzero(plant.oneway == oneway)[:4]]
    record(
        "surface_resistance", seed, tmp_path, given={"surface_resistance": {"roads": roads, "factor": 2.2}}
    )
    (finding,) = diagnosed(tmp_path, "nothing")["findings"]
    assert finding["term"] == "surface_resistance"
    assert ("grade" in finding["not_excluded"]) == oneway
    if oneway:
        assert "other direction" in finding["needs"]
