"""Real drives: a vehicle calibrated on the other trips, with and without altitude (tests/proofs/energy_reality.py)."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def proof(project_root: Path) -> ModuleType:
    path = project_root / "tests" / "proofs" / "energy_reality.py"
    spec = importlib.util.spec_from_file_location("energy_reality", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["energy_reality"] = module
    spec.loader.exec_module(module)
    return module


def test_altitude_explains_the_power_of_a_motorway_run(proof: ModuleType, shared_data: Path) -> None:
    trips = proof.leaf_trips(shared_data / "tripviewer" / "tripviewer_hesperia_la.csv")
    table, r2 = proof.judge(trips, proof.LEAF)
    assert r2["without"] < 0.1
    assert r2["with"] > 0.90
    whole = table["with altitude"].sum() / table["measured Wh"].sum()
    assert whole == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_altitude_helps_on_every_window_of_a_small_electric_car(proof: ModuleType, shared_data: Path) -> None:
    trips = [proof.twizy_trip(p) for p in sorted((shared_data / "twizy" / "T3").glob("*.csv"))]
    table, r2 = proof.judge(trips, proof.TWIZY)
    assert len(table) == 4
    assert r2["with"] > 0.5 > r2["without"] + 0.3
    assert (table["window error with [Wh]"] < table["window error without [Wh]"]).all()
