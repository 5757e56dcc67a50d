"""The page of a diagnosis: whom a finding concerns, where, when, and what to do about it."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from fleetlog.discovery.report.finding import Finding, Parameter, Verdict
from fleetlog.discovery.report.output import lines
from fleetlog.discovery.report.words import onward, statement, unknown
from fleetlog.physics.power import all_terms
from fleetlog.report.diagnosis import _ranking, _todo

SCOPE = {"vehicles": None, "from": None, "until": None}
WORN = Finding(
    "surface_resistance", "battery_power", "The floor is worn", [], None, ["x", "y"],
    {"edges": [{"edge_id": "-yard", "from": 0.0, "to": 9.0, "value": 3.0, "low": 2.5, "high": 3.5}], "extent": []},
    None, SCOPE, [], {"held_out_gain": 0.2, "alternatives": []}, {},
)  # fmt: skip


def spoken(finding: Finding) -> list[str]:
    """What the terminal says of a finding."""
    return lines(SimpleNamespace(verdict=Verdict([], [finding], [])))[1:]


def rows(*findings: Finding, zone: str = "UTC") -> list[list[str]]:
    table = _todo(list(findings), zone)
    assert table is not None
    return table.rows


@pytest.mark.parametrize(
    "term", [t for t in all_terms().values() if t.told and t.sentence], ids=lambda t: t.name
)
def test_every_term_that_can_be_found_says_what_to_do(term) -> None:
    assert term.advice and term.advice[0].isupper() and not term.advice.endswith(".")


@pytest.mark.parametrize("term", [t for t in all_terms().values() if t.told], ids=lambda t: t.name)
def test_a_statement_is_one_sentence_that_leaves_advice_to_the_term_and_writes_percent_with_a_space(
    term,
) -> None:
    numbers = [Parameter(p.name, 0.2, 0.1, 0.3, p.unit) for p in term.parameters]
    numbers += [Parameter(term.extreme, 0.2, 0.1, 0.3, "1")] if term.extreme else []
    said = statement(term, numbers, WORN.where, None)
    assert ". " not in said and not re.search(r"\d%", said)


@pytest.mark.parametrize(
    "until, said",
    [
        ("13T08:59", "13 April 2026, 08:00 to 08:59 UTC"),
        ("14T08:59", "13 April 2026, 08:00 UTC to 14 April 2026, 08:59 UTC"),
    ],
)
def test_a_time_within_a_day_names_the_day_once(until: str, said: str) -> None:
    moments = {"from": "2026-04-13T08:00:00+00:00", "until": f"2026-04-{until}:00+00:00"}
    text = unknown(["time"], None, {"vehicles": ["T3"], **moments})
    assert text.startswith(f"Truck T3, from {said}: a mismatch that")


def test_the_terminal_says_what_to_do() -> None:
    assert spoken(WORN)[1] == f"    What to do: {all_terms()['surface_resistance'].advice}."


def test_an_odd_truck_is_named_and_is_to_be_compared_with_the_others() -> None:
    scope = {**SCOPE, "vehicles": ["T1"]}
    assert unknown(["vehicle_id"], None, scope).startswith("Truck T1: a mismatch ")
    odd = replace(WORN, term="unknown", scope=scope, where=None, needs="record more")
    assert "other trucks" in spoken(odd)[1] and spoken(odd)[2] == "    Next: record more."
    assert "depends on" in unknown(["vehicle_id"], None, SCOPE)
    # What is fitted as physics that no word of the verdict names is not to be compared, but mended.
    assert all_terms()["brake_drag"].advice in spoken(replace(odd, physics="brake_drag"))[1]


def test_what_unseen_trips_speak_against_is_said_to_be_unconfirmed() -> None:
    evidence = {"held_out_gain": -1e-5, "alternatives": []}
    assert onward(WORN) == "" and len(spoken(WORN)) == 2
    assert "do not confirm it" in spoken(replace(WORN, evidence=evidence))[2]
    rival = replace(WORN, evidence=evidence, not_excluded=["grade"], needs="drive both ways")
    assert spoken(rival)[2].endswith(
        "These data cannot tell it from grade. To tell them apart: drive both ways."
    )
    assert onward(rival, str.upper).startswith("These data cannot tell it from GRADE.")


def test_a_row_names_trucks_place_and_time_of_the_site() -> None:
    assert rows(WORN)[0][1:4] == ["all", "on road -yard", "always"]
    assert WORN.where is not None
    (one,) = WORN.where["edges"]
    both = replace(WORN, where={"edges": [one, one | {"edge_id": "yard"}], "extent": []})
    assert rows(both)[0][2] == "on road yard"
    begin, end = "2026-03-16T08:02:00+00:00", "2026-03-16T09:02:00+00:00"
    brake = replace(WORN, term="rolling_resistance", where=None, scope=SCOPE | {"vehicles": ["T3"]})
    heater = replace(WORN, term="auxiliary_load", where=None, scope=SCOPE | {"from": begin, "until": end})
    first, second = rows(brake, heater, zone="Europe/Berlin")
    assert first[0] == "1. Rolling resistance" and first[1:4] == ["T3", "everywhere", "always"]
    assert second[3] == "from 16 Mar 2026 09:02 to 10:02 (Europe/Berlin)"
    assert second[4].startswith("Find out what changed then. ")
    since = replace(heater, scope=SCOPE | {"from": begin})
    until = replace(heater, scope=SCOPE | {"until": end})
    assert [r[3] for r in rows(since, until)] == [
        "from 16 Mar 2026 08:02 (UTC)",
        "until 16 Mar 2026 09:02 (UTC)",
    ]


def test_what_no_term_explains_says_what_to_record() -> None:
    unknown = replace(WORN, term="unknown", needs="record more trucks")
    assert rows(unknown)[0][4] == "Record more trucks."
    assert rows(replace(unknown, needs=None))[0][4].startswith("Compare the trucks")
    assert _todo([], "UTC") is None


def test_explanations_stand_once_and_in_order() -> None:
    others = [{"term": "grade", "held_out_gain": g} for g in (0.05, 0.1)]
    ranked = _ranking(replace(WORN, evidence={"held_out_gain": 0.2, "alternatives": others}))
    assert [(name, gain) for name, gain, _, _ in ranked] == [
        ("surface resistance", "20.0 %"),
        ("grade", "10.0 %"),
    ]
    assert [own for *_, own in ranked] == [True, False]
