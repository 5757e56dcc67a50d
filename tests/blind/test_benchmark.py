"""The blind benchmark itself: a recorder that knows nothing of fleetlog, a scorer that is strict, and a handful of its cases."""

from __future__ import annotations

import ast
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effects import OUTSIDE, TERMS
from recorder import record
from score import judge, overlap, parameters
from table import one

from fleetlog.physics.power import all_terms

HERE = Path(__file__).parent


@pytest.mark.parametrize("module", ["recorder", "plants", "effects"])
def test_the_recorder_shares_no_code_with_the_model(module: str) -> None:
    tree = ast.parse((HERE / f"{module}.py").read_text(encoding="utf-8"))
    imported = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not any(name.split(".")[0] == "fleetlog" for name in imported)


def test_every_term_of_the_vocabulary_can_be_concealed() -> None:
    nominal = {"gravity", "inertia", "rolling", "lift", "acceleration"}
    assert set(TERMS) >= {t.name for t in all_terms().values() if t.parameters} - nominal


def rows(folder: Path) -> list[list[str]]:
    with gzip.open(folder / "recorded.csv.gz", "rt", encoding="utf-8") as text:
        return [line.split(",") for line in text][1:]


def test_a_recording_is_its_seed_and_a_clean_twin_has_the_same_drives(tmp_path: Path) -> None:
    for name, folder in (("none", "a"), ("none", "b"), ("auxiliary_load", "c")):
        record(name, 7, tmp_path / folder, vehicles=1, hours=0.2)
    a, b, c = (rows(tmp_path / f) for f in "abc")
    assert a == b
    assert [r[:7] for r in a] == [r[:7] for r in c]
    more = np.array([float(r[7]) for r in c]) - np.array([float(r[7]) for r in a])
    key = json.loads((tmp_path / "c" / "key.json").read_text())["effect"]["auxiliary_load"]["power"]
    truck = (tmp_path / "c" / "truck.toml").read_text().split("[auxiliary]\npower = ")[1].split("\n")[0]
    assert more.mean() == pytest.approx(key - float(truck), rel=0.03)


def finding(
    term: str, *, not_excluded: tuple[str, ...] = (), follows: tuple[str, ...] = (), **more: Any
) -> dict[str, Any]:
    return {
        "term": term,
        "not_excluded": list(not_excluded),
        "depends_on": list(follows),
        "where": None,
        "parameters": [],
        **more,
    }


@pytest.mark.parametrize(
    ("truth", "said", "word"),
    [
        ([], [], "right"),
        ([], [finding("grade")], "false alarm"),
        (["grade"], [], "missed"),
        (["grade"], [finding("grade")], "right"),
        (["grade"], [finding("grade"), finding("wind")], "extra"),
        (["grade"], [finding("wind")], "wrong"),
        (["grade"], [finding("wind", not_excluded=("grade",))], "undecided"),
        (["grade"], [finding("unknown")], "undecided"),
        (["grade", "wind"], [finding("wind")], "partly"),
        (["odd_vehicle"], [finding("unknown", follows=("vehicle_id",))], "right"),
        (["odd_vehicle"], [finding("unknown", follows=("soc",))], "undecided"),
        (["odd_vehicle"], [finding("payload")], "wrong"),
    ],
)  # fmt: skip
def test_the_scorer_is_strict(truth: list[str], said: list[dict[str, Any]], word: str) -> None:
    assert judge({"terms": truth}, {"findings": said}) == word


def test_numbers_and_roads_are_compared_with_the_key() -> None:
    number = {"name": "factor", "value": 2.1, "low": 2.0, "high": 2.2, "unit": "1"}
    where = {"edges": [{"edge_id": "-r01"}, {"edge_id": "r02"}]}
    said = {"findings": [finding("surface_resistance", parameters=[number]) | {"where": where}]}
    key = {
        "terms": ["surface_resistance"],
        "where": ["r01", "r03"],
        "effect": {"surface_resistance": {"factor": 2.3, "roads": [1, 3]}},
    }
    assert parameters(key, said) == [
        {"term": "surface_resistance", "name": "factor", "truth": 2.3, "value": 2.1, "low": 2.0, "high": 2.2}
    ]
    assert overlap(key, said) == pytest.approx(1.0 / 3.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["none", "drivetrain_efficiency", "waiting", "grade+auxiliary_load", "wind+lift_efficiency", OUTSIDE[0]],
)
def test_concealed_effects_are_named(name: str, tmp_path: Path) -> None:
    row = one(name, 1002, tmp_path)
    assert row["word"] == "right", row
