"""Public logs diagnosed without the column that explains them, and judged against it: the figures of docs/proof.md, with room."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleetlog.discovery.finding import Finding
from tests.proofs.hidden_column import judged, run

pytestmark = pytest.mark.slow


def _first(findings: list[Finding], term: str) -> Finding:
    return next(f for f in findings if f.term == term)


def test_the_slope_of_a_motorway_is_found_without_altitude(shared_data: Path, tmp_path: Path) -> None:
    d, log = run("tripviewer", shared_data, tmp_path)
    grade = _first(d.verdict.findings, "grade")
    assert d.verdict.word == "found"
    # Driven once and one way: the floor stays possible, and driving back would tell.
    assert "surface_resistance" in grade.not_excluded
    assert "other direction" in (grade.needs or "")
    assert any("passed once" in n for n in d.verdict.notes)
    assert {f.term for f in d.verdict.findings} <= {"grade", "unknown"}
    power = next(c for c in d.verdict.channels if c.name == "battery_power")
    assert power.after < power.before
    against = judged(d, log)
    assert against["correlation"] > 0.88
    assert 0.75 < against["found_over_recorded"] < 1.15
    assert against["in_interval"] > 0.85


def test_the_slopes_of_three_routes_are_found_from_the_state_of_charge(
    shared_data: Path, tmp_path: Path
) -> None:
    d, log = run("twizy", shared_data, tmp_path)
    terms = [f.term for f in d.verdict.findings]
    assert terms[0] == "grade"
    assert "speed_scale" not in terms
    assert set(terms) <= {"grade", "unknown"}
    soc = d.verdict.channels[0]
    # On days that no step has seen.
    assert soc.after < 0.65 * soc.before
    against = judged(d, log)
    assert against["correlation"] > 0.72
    assert 0.6 < against["found_over_recorded"] < 1.1
    assert against["in_interval"] > 0.85


def test_floors_are_told_apart_by_their_resistance(shared_data: Path, tmp_path: Path) -> None:
    d, log = run("borealtc", shared_data, tmp_path)
    assert [(f.term, f.depends_on) for f in d.verdict.findings] == [("unknown", ["trip_id"])]
    power = d.verdict.channels[0]
    assert power.after < 0.8 * power.before
    against = judged(d, log)
    mean = against["mean"]
    assert list(mean)[-2:] == ["SANDY_LOAM", "SNOW"]
    assert next(iter(mean)) == "FLOORING"
    assert mean["SNOW"] > mean["SANDY_LOAM"] + 0.05 > mean["ASPHALT"] + 0.08
    assert against["variance_between_surfaces"] > 0.7
