"""The scorer is strict, and reads both versions of the format."""

from __future__ import annotations

from typing import Any

import pytest
from score import adjusted, by_effect, certain_and_wrong, excess, faults, judge

NOBODY = {"vehicles": None, "from": None, "until": None, "drift": False}


def effect(term: str, **more: Any) -> dict[str, Any]:
    plain = {"term": term, "parameters": {}, "roads": [], "follows": [], "accept": [], "scope": NOBODY}
    return plain | {"oracle": {"share": 0.5}} | more


def key(*effects: dict[str, Any], allowed: tuple[str, ...] = ()) -> dict[str, Any]:
    terms = [e["term"] for e in effects]
    return {"terms": terms, "effects": list(effects), "allowed": list(allowed), "seconds": 9000.0}


def finding(term: str, **more: Any) -> dict[str, Any]:
    plain = {"term": term, "channel": "battery_power", "not_excluded": [], "depends_on": [], "where": None}
    return plain | {"parameters": [], "scope": {}} | more


def document(*findings: dict[str, Any], **more: Any) -> dict[str, Any]:
    verdict = "none" if not findings else "unknown" if findings[0]["term"] == "unknown" else "found"
    return {"format_version": 2, "verdict": verdict, "channels": [], "findings": list(findings)} | more


GRADE, WIND = effect("grade"), effect("wind")
DRAG = effect("slow_drag", follows=["speed"])
ODD = effect(
    "odd_vehicle", follows=["vehicle_id"], accept=["rolling_resistance"], scope=NOBODY | {"vehicles": ["T1"]}
)


@pytest.mark.parametrize(
    ("truth", "said", "word", "certain"),
    [
        ([], [], "right", False),
        ([], [finding("grade")], "false alarm", True),
        ([], [finding("unknown")], "false alarm", False),
        ([GRADE], [], "missed", False),
        ([GRADE], [finding("grade")], "right", False),
        ([GRADE], [finding("grade"), finding("wind")], "extra", True),
        ([GRADE], [finding("wind")], "wrong", True),
        ([GRADE], [finding("wind", not_excluded=["grade"])], "undecided", False),
        ([GRADE], [finding("unknown")], "undecided", False),
        ([GRADE, WIND], [finding("wind")], "partly", False),
        ([DRAG], [finding("unknown", depends_on=["speed"])], "right", False),
        ([DRAG], [finding("unknown", depends_on=["soc"])], "undecided", False),
        ([DRAG], [finding("payload")], "wrong", True),
        ([ODD], [finding("rolling_resistance", scope={"vehicles": ["T1"]})], "right", False),
        ([ODD], [finding("rolling_resistance")], "undecided", False),
    ],
)  # fmt: skip
def test_the_scorer_is_strict(
    truth: list[dict[str, Any]], said: list[dict[str, Any]], word: str, certain: bool
) -> None:
    assert judge(key(*truth), document(*said)) == word
    assert certain_and_wrong(key(*truth), document(*said)) == certain


def test_what_the_logger_does_may_be_said_and_need_not() -> None:
    assert judge(key(allowed=("clock_offset",)), document(finding("clock_offset"))) == "right"
    assert judge(key(allowed=("clock_offset",)), document()) == "right"


def test_numbers_and_roads_are_compared_with_the_key() -> None:
    number = {"name": "factor", "value": 2.1, "low": 2.0, "high": 2.2, "unit": "1"}
    where = {"edges": [{"edge_id": "-r01"}, {"edge_id": "r02"}]}
    truth = effect("surface_resistance", parameters={"factor": 2.3}, roads=["r01", "r03"])
    (told,) = by_effect(key(truth), document(finding("surface_resistance", parameters=[number], where=where)))
    assert told["told"] == "named"
    assert told["numbers"] == [
        {"name": "factor", "truth": 2.3, "size": 2.3, "value": 2.1, "low": 2.0, "high": 2.2}
    ]
    assert told["overlap"] == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    ("said", "right", "late"),
    [
        ({"vehicles": ["T3"], "from": "2026-04-13T07:03:00Z", "until": None}, True, 0.02),
        ({"vehicles": ["T3"], "from": None, "until": None}, False, None),
        ({"vehicles": None, "from": "2026-04-13T07:00:00Z"}, False, 0.0),
        ({}, False, None),
    ],
)
def test_scopes_are_compared_with_the_key(said: dict[str, Any], right: bool, late: float | None) -> None:
    scope = {"vehicles": ["T3"], "from": "2026-04-13T07:00:00.000Z", "until": None, "drift": False}
    (told,) = by_effect(key(effect("grade", scope=scope)), document(finding("grade", scope=said)))
    assert told["scope"] == right
    assert told["late"] == (None if late is None else pytest.approx(late))


def test_numbers_that_are_none_and_bounds_are_faults() -> None:
    number = {"name": "k", "value": 0.2, "low": 0.1, "high": 0.2, "unit": "m"}
    said = document(finding("cornering_resistance", parameters=[number]), channels=[{"before": float("nan")}])
    assert faults(said) == ["not a number: channels.0.before", "cornering_resistance k on its bound"]
    assert faults(document(finding("wind"))) == []


def test_the_floor_is_that_of_the_channels_with_findings() -> None:
    channels = [
        {"name": "battery_power", "before": 0.3, "after": 0.06, "floor": 0.05},
        {"name": "soc", "before": 0.1, "after": 0.1, "floor": 0.05},
    ]
    assert excess(document(finding("wind"), channels=channels)) == {"battery_power": pytest.approx(1.2)}
    assert excess(document(finding("wind"), channels=channels) | {"format_version": 1}) == {}
    assert excess(document(channels=channels)) == {
        "battery_power": pytest.approx(1.2),
        "soc": pytest.approx(2.0),
    }


@pytest.mark.parametrize(
    ("low", "high", "right"), [(0.93, 0.97, True), (3700.0, 3900.0, True), (0.99, 1.01, False)]
)
def test_a_wrong_truck_file_is_told_as_an_adjustment(low: float, high: float, right: bool) -> None:
    truth = key() | {"adjustments": [{"name": "mass", "value": 3800.0, "file": 4000.0}]}
    said = [{"name": "chassis.mass", "vehicle": None, "value": (low + high) / 2.0, "low": low, "high": high}]
    assert adjusted(truth, document(adjustments=said)) == [right]
    assert adjusted(truth, document(adjustments=[])) == [False]
