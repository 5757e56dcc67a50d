"""Trucks as rigid bodies: the engine drives the plan, and takes the energy that mechanics says it must."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from cases import Case
from engine import drive
from power import HZ, Motion, balance
from shifts import shift
from world import World, world

pytest.importorskip("mujoco", reason="the wheel mujoco is not installed")
SECONDS = 300


def planned(case: str) -> tuple[World, Motion]:
    """A world, and the first minutes of its first truck."""
    w = world(Case.parse(f"{case},seed=11,by=engine"))
    m, _ = shift(w, 0, 0, np.random.default_rng(1))
    return w, replace(m, **{f.name: getattr(m, f.name)[: SECONDS * HZ] for f in fields(m)})


def joules(case: str) -> tuple[float, Motion]:
    """Energy in the engine [J], and the motion there."""
    w, m = planned(case)
    moved, terminal, _ = drive(w, m, w.truck, 0)
    return float(terminal.sum()) / HZ, moved


def test_the_engine_drives_the_plan() -> None:
    w, m = planned("none")
    moved, _, _ = drive(w, m, w.truck, 0)
    assert np.hypot(moved.x - m.x, moved.y - m.y).max() < 0.5
    assert np.quantile(np.abs(moved.v - m.v), 0.99) < 0.3


def test_energy_is_that_of_a_balance_of_forces_within_what_an_efficiency_map_takes() -> None:
    w, m = planned("none")
    moved, terminal, _ = drive(w, m, w.truck, 0)
    told, _ = balance(moved, w.truck, [], 0)
    assert terminal.sum() == pytest.approx(told.sum(), rel=0.03)


@pytest.mark.parametrize("case", ["grade", "rolling_resistance", "viscous_drag", "mass", "slow_drag"])
def test_what_is_concealed_takes_as_much_in_the_engine_as_in_a_balance(case: str) -> None:
    changed, _ = joules(case)
    plain, _ = joules("none")
    w, m = planned(case)
    told = (balance(m, w.truck, w.effects, 0)[0] - balance(m, w.truck, [], 0)[0]) / HZ
    assert changed - plain == pytest.approx(told.sum(), abs=0.12 * np.abs(told).sum())
