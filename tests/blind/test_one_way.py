"""Floors: on one-way roads they roll hard or climb, and energy cannot tell; on all roads they are a number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cases import Case
from degrade import diagnosed
from effects import Effect
from recorder import record
from run import run
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


@pytest.mark.slow
def test_what_rolls_more_easily_everywhere_is_a_number_beside_the_worn_roads(tmp_path: Path) -> None:
    """Every road has its own value, and a field could say them all."""
    done = run(Case.parse("surface_resistance+rolling_resistance+cornering_speed,seed=5050"), tmp_path)
    worn, rolls, _ = done["key"]["effects"]
    found = {f["term"]: f for f in done["found"]["findings"]}
    assert set(found) == {"surface_resistance", "rolling_resistance", "cornering_speed"}
    for effect, name in ((worn, "factor"), (rolls, "coefficient")):
        (number,) = found[effect["term"]]["parameters"]
        assert number["low"] <= effect["parameters"][name] <= number["high"]
    edges = {e["edge_id"].removeprefix("-") for e in found["surface_resistance"]["where"]["edges"]}
    assert edges == set(worn["roads"])
