"""A floor on one-way roads rolls hard, or they climb: energy cannot tell, and the diagnosis says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cases import Case
from degrade import diagnosed
from effects import Effect
from recorder import record
from world import world


@pytest.mark.slow
@pytest.mark.parametrize(("oneway", "seed"), [(True, 51), (True, 53), (False, 51)])
def test_slope_and_floor_are_told_apart_where_both_directions_are_driven(
    oneway: bool, seed: int, tmp_path: Path
) -> None:
    case = Case(("surface_resistance",), seed=seed)
    layout = world(case).site.layout
    roads = tuple(int(k) for k in np.flatnonzero(layout.oneway == oneway)[:4])
    record(case, tmp_path, [Effect("surface_resistance", {"factor": 2.2}, roads)])
    (finding,) = diagnosed(tmp_path, "nothing")["findings"]
    assert finding["term"] == "surface_resistance"
    assert ("grade" in finding["not_excluded"]) == oneway
    if oneway:
        assert "both directions" in finding["needs"]
