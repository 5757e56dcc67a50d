"""What is taken out of a model leaves nothing behind that could do its work, and nothing else goes with it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fleetlog.core.truck import load_truck
from fleetlog.discovery.candidates import Candidate
from fleetlog.discovery.dropping import without
from fleetlog.discovery.evidence import Evidence
from fleetlog.discovery.model import Found
from fleetlog.discovery.select import Choice, Gain
from fleetlog.discovery.task import State
from fleetlog.physics.power import all_terms

DRAG, VISCOUS, HEATING = "aerodynamic_drag", "viscous_drag", "thermal_load"
FOLLOWS = {DRAG: ("speed",), VISCOUS: ("speed",), HEATING: ("ambient_temperature",), "soc": ("soc",)}
CURVES = {"speed": ("speed",), "ambient_temperature": ("ambient_temperature",), "soc": ("soc",)}


def chosen(name: str) -> Choice:
    candidate = Candidate(name, "scalar", all_terms().get(name), FOLLOWS[name])
    gain = Gain({"trip": 0.1}, {"trip": 0.01}, np.zeros(2), 0.1, 1.0)
    return Choice(candidate, Evidence(9.0, 9.0, np.zeros(1, int), 1.0, 0.001), gain)


def left(drop: str, *names: str) -> State:
    """A model of explanations with all curves in it, with ``drop`` taken out."""
    choices = [chosen(n) for n in names]
    curves = {n: Candidate(n, "generic", None, over) for n, over in CURVES.items()}
    task = SimpleNamespace(
        candidates=curves | {c.candidate.name: c.candidate for c in choices if c.candidate.named}
    )
    found = Found(load_truck("three-wheel-2t"), {n: {"first": 1.0} for n in names if n in all_terms()})
    state = State(found, choices, dict.fromkeys(CURVES, 1.0))
    return without(cast(Any, task), state, next(c for c in choices if c.candidate.name == drop))


@pytest.mark.parametrize(
    ("drop", "names", "curves"),
    [
        (DRAG, (DRAG, HEATING), {"ambient_temperature", "soc"}),
        (HEATING, (DRAG, HEATING), {"speed", "soc"}),
        # Another term over the same variable still has its companion.
        (DRAG, (DRAG, VISCOUS), {"speed", "ambient_temperature", "soc"}),
        # A curve that was chosen itself is no companion, and goes when it is dropped.
        (DRAG, (DRAG, "soc"), {"ambient_temperature", "soc"}),
        ("soc", (DRAG, "soc"), {"speed", "ambient_temperature"}),
    ],
)
def test_what_is_dropped_takes_its_own_curves_along(
    drop: str, names: tuple[str, ...], curves: set[str]
) -> None:
    state = left(drop, *names)
    assert set(state.curves) == curves
    assert state.names() == [n for n in names if n != drop]
    assert set(state.found.values) == {n for n in names if n != drop and n in all_terms()}
