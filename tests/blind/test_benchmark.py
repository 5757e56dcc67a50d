"""A handful of the benchmark's cases, run as its script runs them."""

from __future__ import annotations

from pathlib import Path

import pytest
from cases import Case
from judged import inside, judged
from run import run


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "auxiliary_load+grade,seed=1002", "lift_efficiency+wind,seed=1002", "warm_up,seed=1002",
        # A heating's threshold, two numbers that a curve says as well, power in steps (decision 41).
        "thermal_load+drivetrain_efficiency+lift_efficiency,seed=5005",
        "viscous_drag+rolling_resistance,together=opposite,seed=5005",
        "none,site=corridor,logger=power_500w,seed=5006",
        # Waits on stretches of lanes that are not those of roads; corners that are cut (decision 42).
        "auxiliary_load+laden_speed+waiting,seed=5007",
        "cornering_resistance,site=grid,seed=4011,vehicles=10,hours=1.0",
        # A hill beside junctions, a load that grows as the day warms, zones of which one ends at a junction (54).
        "grade+surface_resistance,together=road,seed=4306",
        "auxiliary_load,scope=drift,seed=4306,vehicles=6,hours=2.0", "speed_zone,site=ramps,seed=4306",
        # An inertia most of which the tolerances of efficiency and mass say as well (55).
        "surface_resistance+aerodynamic_drag+rotational_inertia,seed=4307",
        "speed_scale,site=none,seed=4307",
        # Positions alone, 1 Hz: slight accelerations of a cruise are none (66).
        "grade,site=yard,logger=no_speed,seed=7115,vehicles=6,hours=2.0",
        # A curve of the acceleration that unseen trips do not show (72).
        "cornering_resistance+viscous_drag+copper_loss,seed=5046",
        # Trucks that stand at one place of a slow road, told as a road that is slower still (72).
        "speed_zone+waiting,together=road,seed=5048",
    ],
)  # fmt: skip
def test_concealed_effects_are_named(name: str, tmp_path: Path) -> None:
    row = judged(run(Case.parse(name), tmp_path))
    assert row["word"] == "right", row.get("error", row.get("found"))
    assert not row["faults"]
    waits = [n for e in row["effects"] if e["term"] == "waiting" for n in e["numbers"]]
    assert all(inside(n) for n in waits), waits
    # Noise is what a right model leaves, be what it explains large or small.
    for c in row["found"]["channels"]:
        assert c["floor"] is None or 0.5 < c["after"] / c["floor"] < 2.0, c
