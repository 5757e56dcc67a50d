"""Whom and when: scopes are recovered from products alone, and cost nothing where nothing changes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Chassis, Truck
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import FLEET, Knob, Model, Scope
from fleetlog.discovery.search import scopes
from fleetlog.discovery.search.beside import Beside
from fleetlog.discovery.search.ridge import Prior
from fleetlog.discovery.search.scopes import Column, _kind, _parts, trips_agree
from fleetlog.discovery.settings import SETTINGS
from fleetlog.physics.power import battery_power

TRUCK = Truck(Chassis(4000.0))
FOLDS, VEHICLES, SLOTS, EACH = 10, 6, 48, 12
EDGES = np.linspace(0.0, 4800.0, SLOTS + 1)


def column(weight: np.ndarray, effect: float, seed: int) -> Column:
    """A column beside a constant, its (V, S) ``weight`` times ``effect`` concealed in noise of one."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.5, 1.5, (FOLDS, VEHICLES, SLOTS, EACH))
    y = effect * weight[None, :, :, None] * x + 3.0 + rng.normal(0.0, 1.0, x.shape)
    count = np.full((FOLDS, 1, 1), VEHICLES * SLOTS * EACH, float)
    model = Beside(
        count, y.sum(axis=(1, 2, 3))[:, None], Prior(np.zeros(1), np.zeros(1), -np.ones(1), np.ones(1))
    )
    cross = x.sum(axis=3)[..., None]
    products = (x * y).sum(axis=3), (x**2).sum(axis=3)
    return Column(model, cross, np.ones(1, bool), cross.sum(axis=0), *products, 2.0)


def over(begin: int, until: int, who: tuple[int, ...]) -> np.ndarray:
    weight = np.zeros((VEHICLES, SLOTS))
    weight[list(who), begin:until] = 1.0
    return weight


@given(st.integers(0, 42), st.integers(1, 6), st.sets(st.integers(0, 5), min_size=1), st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_all_scopes_at_once_gain_what_each_does_alone(
    begin: int, long: int, who: set[int], seed: int
) -> None:
    """A column beside a model gains the square of its moment over its own, once the model is taken away."""
    own = column(over(20, 30, (1, 2)), 1.0, seed)
    trucks, slots = np.isin(np.arange(VEHICLES), list(who)) * 1.0, over(begin, begin + long, (0,))[:1]
    left = own.model.left(own.added(np.outer(trucks, slots[0])))
    alone = left.moment[0] ** 2 / left.product[0, 0] / own.unit
    for gain, step in (own.gain(trucks, slots), own.gain(trucks[None], slots[0])):
        assert gain[0] == pytest.approx(alone) and step[0] == pytest.approx(
            left.moment[0] / left.product[0, 0]
        )


@given(st.integers(0, 40), st.integers(6, 48), st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_a_period_is_found_where_it_is(begin: int, long: int, seed: int) -> None:
    until = min(begin + long, SLOTS)
    everyone = tuple(range(VEHICLES))
    if until - begin == SLOTS:
        return
    (_, scope, _), _ = _parts(column(over(begin, until, everyone), 1.0, seed), EDGES, everyone)
    for said, true, end in ((scope.begin, begin, 0), (scope.until, until, SLOTS)):
        if np.isfinite(said):
            assert abs(said - EDGES[true]) <= 2 * (EDGES[1] - EDGES[0])
        else:
            assert abs(true - end) <= 2


@given(st.integers(0, 99))
@settings(max_examples=10, deadline=None)
def test_a_drift_beats_every_period_and_a_step_beats_the_drift(seed: int) -> None:
    everyone = tuple(range(VEHICLES))
    ramp = np.tile((np.arange(SLOTS) + 0.5) / SLOTS, (VEHICLES, 1))
    part, drift = _parts(column(ramp, 1.0, seed), EDGES, everyone)
    assert drift[0] > part[0] and drift[1].drift
    part, drift = _parts(column(over(20, SLOTS, everyone), 1.0, seed), EDGES, everyone)
    assert part[0] > drift[0] and not part[1].drift


@given(st.sets(st.integers(0, 5), min_size=2, max_size=3), st.integers(0, 99), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=20, deadline=None)
def test_a_kind_of_trucks_is_found(who: set[int], seed: int, sign: float) -> None:
    ((scope, _),) = _kind(column(over(0, SLOTS, tuple(who)), sign, seed))
    assert scope.vehicles == tuple(sorted(who))


def test_what_does_not_change_gains_nothing_unseen() -> None:
    everyone, gains = tuple(range(VEHICLES)), []
    for seed in range(60):
        nothing = column(np.zeros((VEHICLES, SLOTS)), 0.0, seed)
        (_, _, weight), _ = _parts(nothing, EDGES, everyone)
        gains.append(float(nothing.validated(weight)[0].sum()))
    # The scope was chosen on all folds, so a little is left; its choice costs eight, and the number four.
    assert np.quantile(gains, 0.98) < 8.0


@pytest.mark.parametrize(
    ("begin", "until", "told"), [(20, 26, False), (20, 32, True), (42, SLOTS, True), (0, 6, True)]
)
@pytest.mark.parametrize("unsteady", [frozenset(), frozenset({0})])
def test_what_comes_and_goes_between_two_knots_is_none_of_a_battery_whose_power_was_told_by_curves(
    begin: int, until: int, told: bool, unsteady: frozenset[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The curves cannot follow a change within a fifth of the time; what lasts from or until then is told."""
    everyone = tuple(range(VEHICLES))
    found = column(over(begin, until, everyone), 1.0, 1)
    (_, scope, weight), _ = _parts(found, EDGES, everyone)
    sums = SimpleNamespace(edges=EDGES, by_class=False, loosened=lambda _: (np.zeros(FOLDS), 0.0))
    monkeypatch.setattr(scopes, "Slotted", lambda *_: sums)
    monkeypatch.setattr(scopes, "_likely", lambda *_: [(found, scope, weight)])
    problem = SimpleNamespace(channel=SimpleNamespace(unsteady=unsteady), price=lambda _: 0.0)
    number = Hypothesis("battery_capacity", (Knob("battery_capacity", "capacity_wh", FLEET),))
    screened = [SimpleNamespace(hypothesis=number)]
    out = scopes.scoped(problem, SimpleNamespace(chosen=()), screened)  # type: ignore[arg-type]
    assert bool(out) is (told or not unsteady)


def test_a_scope_concerns_its_vehicles_and_its_time_alone() -> None:
    knob = Knob("auxiliary_load", "power", Scope((1,), 40.0))
    model = Model(TRUCK, {knob: 300.0, Knob("auxiliary_load", "power", FLEET): 500.0})
    still = Motion.of(100, dt=1.0, time=np.arange(100.0))
    other, own = (battery_power(still, model.physics(v, still, lambda _: None)) for v in (0, 1))
    assert other == pytest.approx(500.0)
    assert own == pytest.approx(np.where(still.time < 40.0, 500.0, 800.0))


@pytest.mark.parametrize(
    ("off", "agree"), [([30.0, 20.0], False), ([5.0] * 10, True), ([5.0, -5.0] * 9, False)]
)
def test_a_time_is_told_by_many_trips_and_not_by_two(
    off: list[float], agree: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fifty squares that speak for a time, from some trips out of thirty; or as many for it as against."""
    gain = np.zeros(30)
    gain[: len(off)] = off
    unit = SimpleNamespace(windows=np.arange(30), whole=np.ones(30, bool), recorded=np.zeros(30))
    problem = SimpleNamespace(
        settings=SETTINGS, training=lambda: [unit], split=SimpleNamespace(unit=lambda w: w),
        noise=SimpleNamespace(weight=lambda _: np.ones(30)), channel=None,
    )  # fmt: skip
    monkeypatch.setattr(scopes, "said", lambda _channel, _unit, joint: (joint, 0.0 * joint))
    always, timed = np.sqrt(np.maximum(gain, 0.0)), np.sqrt(np.maximum(-gain, 0.0))
    assert trips_agree(cast(Any, problem), cast(Any, always), cast(Any, timed)) is agree
