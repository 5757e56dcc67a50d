"""Public logs diagnosed without the column that explains them, and judged against it: the figures of docs/proof.md, with room."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.discovery.report.finding import ChannelFit, Finding
from tests.proofs.hidden_column import judged, run
from tests.proofs.hidden_judges import classes
from tests.proofs.public_logs import Log

Diagnosed = Callable[[str], tuple[Diagnosis, Log]]

pytestmark = pytest.mark.slow


def _first(findings: list[Finding], term: str) -> Finding:
    return next(f for f in findings if f.term == term)


def _channel(d: Diagnosis, name: str) -> ChannelFit:
    return next(c for c in d.verdict.channels if c.name == name)


@pytest.fixture(scope="module")
def diagnosed(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    """Each log once, for all tests."""
    return cache(lambda name: run(name, shared_data, tmp_path_factory.mktemp(name)))


def test_the_slope_of_a_motorway_is_found_without_altitude(diagnosed: Diagnosed) -> None:
    d, log = diagnosed("tripviewer")
    energy = [f for f in d.verdict.findings if f.channel == "battery_power"]
    assert [f.term for f in energy] == ["grade"]
    assert d.verdict.findings[0].term == "grade"
    assert {f.term for f in d.verdict.findings} <= {"grade", "unknown"}
    assert any("passed once" in n for n in d.verdict.notes)
    power = _channel(d, "battery_power")
    assert power.after < 0.8 * power.before
    against = judged(d, log)
    assert against["correlation"] > 0.88
    assert 0.75 < against["found_over_recorded"] < 1.15
    assert against["in_interval"] > 0.85


def test_a_gauge_of_charge_is_not_explained_by_a_resistance(diagnosed: Diagnosed) -> None:
    d, _ = diagnosed("tripviewer")
    # A per cent of charge is worth more energy where it is full: the log's voltage says so, which was not given.
    assert [(f.term, f.depends_on) for f in d.verdict.findings if f.channel == "soc"] == [
        ("unknown", ["soc"])
    ]


@pytest.mark.xfail(
    strict=True,
    reason="on a road passed once a floor is excluded by 10 natural logarithms, against what is plausible of a floor alone; "
    "a passing load is not weighed at all, and only a note says so",
)
def test_a_motorway_driven_once_leaves_the_floor_open(diagnosed: Diagnosed) -> None:
    d, _ = diagnosed("tripviewer")
    grade = _first(d.verdict.findings, "grade")
    assert "surface_resistance" in grade.not_excluded
    assert "both directions" in (grade.needs or "")


def test_the_slopes_of_three_routes_are_found_from_the_state_of_charge(diagnosed: Diagnosed) -> None:
    d, log = diagnosed("twizy")
    terms = [f.term for f in d.verdict.findings]
    assert "grade" in terms
    assert "speed_scale" not in terms
    assert set(terms) <= {"grade", "unknown"}
    soc = d.verdict.channels[0]
    # On days that no step has seen.
    assert soc.after < 0.65 * soc.before
    against = judged(d, log)
    assert against["correlation"] > 0.72
    assert 0.6 < against["found_over_recorded"] < 1.1
    assert against["in_interval"] > 0.85


def test_floors_are_told_apart_by_their_resistance(diagnosed: Diagnosed) -> None:
    d, log = diagnosed("borealtc")
    found = {tuple(f.depends_on): f for f in d.verdict.findings}
    assert {f.term for f in d.verdict.findings} == {"unknown"}
    trip = found["trip_id",]
    assert trip.fit["after"] < 0.85 * trip.fit["before"]
    against = judged(d, log)
    mean = against["mean"]
    assert list(mean)[-2:] == ["SANDY_LOAM", "SNOW"]
    assert set(list(mean)[:2]) == {"FLOORING", "ICE"}
    assert mean["SNOW"] > mean["SANDY_LOAM"] + 0.03 > mean["ASPHALT"] + 0.04
    assert against["variance_between_surfaces"] > 0.6


def test_what_was_found_of_each_trip_is_known_well_enough_to_tell_surfaces_apart(
    diagnosed: Diagnosed,
) -> None:
    d, log = diagnosed("borealtc")
    trips = classes(d, log)
    snow, hall = ([c for c in trips if c.label == label] for label in ("SNOW", "FLOORING"))
    usual = float(np.median([c.value for c in hall]))
    assert np.mean([c.low > usual for c in snow]) > 0.5


@pytest.mark.parametrize("name", ["bike", "bike-half", "bike-fifth", "bike-uneven"])
def test_a_rider_who_chooses_the_power_is_not_taken_for_physics(diagnosed: Diagnosed, name: str) -> None:
    d, _ = diagnosed(name)
    assert {f.term for f in d.verdict.findings} == {"unknown"}
    assert "speed" in {v for f in d.verdict.findings for v in f.depends_on}


@pytest.mark.parametrize("name", ["escooter", "tripviewer-half", "tripviewer-fifth"])
def test_what_is_too_short_is_not_judged(diagnosed: Diagnosed, name: str) -> None:
    d, _ = diagnosed(name)
    assert not d.verdict.findings
    reasons = [str(c.reason) for c in d.verdict.channels]
    assert all("windows can be used" in r or "motion between them is not known" in r for r in reasons)


@pytest.mark.parametrize("name", ["tripviewer-uneven", "twizy-uneven", "twizy-fifth"])
def test_slopes_are_found_in_poorer_logs(diagnosed: Diagnosed, name: str) -> None:
    d, log = diagnosed(name)
    # Some trips differ beside slopes: a finding, or a note where the trips held out do not show it.
    found = {f.term for f in d.verdict.findings}
    unseen = any("too little for a finding" in n for n in d.verdict.notes)
    assert found == {"grade", "unknown"} or (found == {"grade"} and unseen)
    against = judged(d, log)
    assert against["correlation"] > 0.8
    assert against["in_interval"] > 0.9


def test_floors_are_told_apart_by_the_trip_alone(diagnosed: Diagnosed) -> None:
    d, _ = diagnosed("borealtc")
    assert [(f.term, f.depends_on) for f in d.verdict.findings] == [("unknown", ["trip_id"])]
