"""A field found without a map is not certain where driving, or the moment, explains as much."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fleetlog.discovery.candidates import Candidate
from fleetlog.discovery.open_ends import left_open
from fleetlog.discovery.select import Gain
from fleetlog.discovery.squares import make_squares
from fleetlog.physics.power import all_terms

SQUARES = make_squares(np.arange(500.0), np.zeros(500))


def gain(size: float) -> Gain:
    return Gain({"trip": size}, {"trip": 0.0}, np.zeros(1), 0.1, 1.0)


def opened(name: str, rivals: dict[str, float], pieces: bool = True, floor: object = SQUARES) -> list[str]:
    """The rivals of a field with a gain of 0.1."""
    choice = SimpleNamespace(
        candidate=Candidate(name, "field", all_terms()[name]), gain=gain(0.1), rivals={k: gain(g) for k, g in rivals.items()}, tied=()
    )  # fmt: skip
    task = SimpleNamespace(floor=floor, recording=SimpleNamespace(windows=SimpleNamespace(pieces=pieces)))
    return left_open(task, choice)


@pytest.mark.parametrize(
    ("floor", "pieces", "terms"), [(0.09, True, ["auxiliary_load"]), (0.05, True, []), (0.09, False, [])]
)  # fmt: skip
def test_a_slope_is_sure_where_the_road_gave_back_energy_or_was_driven_again(
    floor: float, pieces: bool, terms: list[str]
) -> None:
    assert opened("grade", {"surface_resistance": floor}, pieces) == terms


@pytest.mark.parametrize(("curve", "terms"), [(0.12, ["regeneration"]), (0.08, [])])
def test_a_hard_floor_is_not_sure_where_braking_explains_more(curve: float, terms: list[str]) -> None:
    assert opened("surface_resistance", {"force by acceleration": curve}) == terms


def test_on_a_map_nothing_is_left_open_here() -> None:
    assert opened("surface_resistance", {"force by acceleration": 0.2}, floor=None) == []
