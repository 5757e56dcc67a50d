"""The battery: exact current, voltage collapse, Peukert, temperature; and the trucks that come with fleetlog."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fleetlog.core.truck import PRESETS, load_truck, preset_names
from fleetlog.errors import TruckError
from fleetlog.physics.battery import BatteryModel, battery_of, discharge
from fleetlog.physics.cycles import vdi2198
from fleetlog.physics.power import Physics, battery_power, cell_power, soc_change

FLAT = BatteryModel(625.0, (0.0, 1.0), (48.0, 48.0))


@given(st.floats(-40_000, 40_000), st.floats(20.0, 100.0), st.floats(0.0, 0.05))
def test_the_current_solves_its_equation(power: float, voltage: float, resistance: float) -> None:
    assume(voltage**2 > 4.0 * resistance * power)
    battery = BatteryModel(625.0, (0.0, 1.0), (voltage, voltage), resistance)
    got = discharge(np.array([power]), np.ones(1), battery, 0.5)
    amps, terminal = got.current[0], got.voltage[0]
    assert not got.collapsed[0]
    assert terminal == pytest.approx(voltage - resistance * amps)
    assert terminal * amps == pytest.approx(power, rel=1e-9, abs=1e-6)
    assert terminal >= voltage / 2.0 - 1e-9  # the stable one of the two roots


@pytest.mark.parametrize(
    ("power", "amps", "sag", "loss"),
    [(3e3, 64, 0.8, 0.016), (10e3, 221, 2.7, 0.055), (20e3, 473, 5.7, 0.118)],
)
def test_a_lead_battery_sags_as_computed_by_hand(power: float, amps: float, sag: float, loss: float) -> None:
    """48 V, 625 Ah, 12 mOhm."""
    i = discharge(np.array([power]), np.ones(1), replace(FLAT, resistance=0.012), 0.5).current
    assert i[0] == pytest.approx(amps, abs=0.6)
    assert 0.012 * i[0] == pytest.approx(sag, abs=0.06)
    assert 0.012 * i[0] / 48.0 == pytest.approx(loss, abs=0.001)


def test_collapse_is_reported_and_never_a_nan() -> None:
    weak = BatteryModel(100.0, (0.0, 1.0), (48.0, 48.0), resistance=0.1)
    limit = 48.0**2 / 0.4
    power = np.array([limit * 0.999, limit * 1.001, 1e9, 0.0])
    got = discharge(power, np.ones(4), weak, 0.9)
    assert got.collapsed.tolist() == [False, True, True, False]
    assert all(np.isfinite(a).all() for a in (got.soc, got.voltage, got.current))
    assert got.voltage[1] == got.voltage[2] == pytest.approx(24.0)
    assert not discharge(np.zeros(3), np.ones(3), weak, 0.9).collapsed.any()


def test_an_empty_battery_stays_at_zero_and_is_marked() -> None:
    got = discharge(np.full(10, 48.0 * 3600.0), np.full(10, 100.0), FLAT, 0.5)
    assert got.soc[-1] == 0.0 and got.empty[-1] and not got.empty[0]
    assert discharge(np.full(5, -1e6), np.full(5, 100.0), FLAT, 0.5).soc.max() == 1.0


@given(st.integers(0, 100), st.floats(0.0, 0.003))
def test_at_constant_voltage_it_is_the_nominal_formula_to_first_order(seed: int, resistance: float) -> None:
    rng = np.random.default_rng(seed)
    power, dt = rng.uniform(-3000, 8000, 50), rng.uniform(0.1, 2.0, 50)
    truck = load_truck("three-wheel-2t").with_value("battery.internal_resistance", resistance)
    nominal = 0.7 + np.cumsum(soc_change(power, dt, truck))
    exact = discharge(power, dt, battery_of(truck), 0.7).soc
    assert battery_of(truck).voltage == (48.0, 48.0)
    # The second order is 2 R^2 P^3 / V^4: what is left of the loss.
    second = np.cumsum(2.0 * resistance**2 * np.abs(power) ** 3 / 48.0**4 * dt) / (
        3600.0 * truck.battery.capacity_wh
    )
    assert np.all(np.abs(exact - nominal) <= 2.0 * second + 1e-12)
    # At no resistance there is nothing but the energy.
    assert resistance > 0 or np.allclose(cell_power(power, truck), power)


@pytest.mark.parametrize(
    ("k", "twice", "thrice"), [(1.05, 0.966, 0.947), (1.2, 0.871, 0.803), (1.3, 0.812, 0.719)]
)
def test_peukert_takes_nothing_at_the_rated_current_and_its_factor_above(
    k: float, twice: float, thrice: float
) -> None:
    rated = 625.0 / 5.0
    battery = BatteryModel(625.0, (0.0, 1.0), (48.0, 48.0), peukert=k)
    for multiple, factor in ((1.0, 1.0), (2.0, twice), (3.0, thrice)):
        got = discharge(np.array([48.0 * rated * multiple]), np.array([60.0]), battery, 1.0)
        plain = rated * multiple * 60.0 / 3600.0 / 625.0
        assert plain / (1.0 - got.soc[0]) == pytest.approx(factor, abs=0.001)
    charging = discharge(np.array([-48.0 * rated * 3.0]), np.array([60.0]), battery, 0.5)
    assert charging.soc[0] - 0.5 == pytest.approx(3.0 * rated / 60.0 / 625.0, rel=1e-9)


def test_resistance_and_peukert_are_never_both() -> None:
    with pytest.raises(TruckError, match="the same loss"):
        BatteryModel(100.0, (0.0, 1.0), (48.0, 48.0), resistance=0.01, peukert=1.2)
    assert battery_of(load_truck("reach-truck"), "lead", peukert=1.2).resistance == 0.0
    with pytest.raises(TruckError, match="did you mean 'lead'"):
        battery_of(load_truck("reach-truck"), "laed")


@pytest.mark.parametrize("chemistry", ["lead", "lfp"])
def test_cold_takes_capacity_and_adds_resistance(chemistry: str) -> None:
    battery = battery_of(load_truck("reach-truck"), chemistry)
    used = [
        1.0 - discharge(np.full(60, 3000.0), np.full(60, 60.0), battery, 1.0, t).soc[-1]
        for t in (20.0, 0.0, -20.0)
    ]
    assert used[0] < used[1] < used[2]
    warm = discharge(np.full(60, 3000.0), np.full(60, 60.0), battery, 1.0).soc
    assert warm[-1] == pytest.approx(1.0 - used[0])  # an unknown temperature counts as 20 degrees
    volts = np.interp(np.linspace(0, 1, 11), battery.soc, battery.voltage)
    assert np.all(np.diff(volts) > 0) and volts[5] == pytest.approx(48.0, rel=0.05)


def test_every_preset_states_the_source_of_every_number() -> None:
    assert preset_names() == [
        "agv-small",
        "counterbalance-2.5t",
        "counterbalance-3.5t",
        "reach-truck",
        "three-wheel-2t",
    ]
    for name in preset_names():
        text = (PRESETS / f"{name}.toml").read_text(encoding="utf-8")
        for line in text.splitlines():
            value = line.split("#")[0].strip()
            if "=" in value and not value.startswith("name"):
                assert "#" in line or "carriage" in text, (name, line)
        numbers = [v for s, d in tomllib.loads(text).items() if s != "name" for v in d.values()]
        sourced = [
            line for line in text.splitlines() if "=" in line and ("sheet" in line or "estimate" in line)
        ]
        assert len(sourced) >= 0.7 * len(numbers)
        assert load_truck(name).name == name


def test_a_truck_that_is_neither_file_nor_preset_is_named() -> None:
    with pytest.raises(TruckError, match="did you mean 'reach-truck'"):
        load_truck("reach-trck")


def test_the_three_wheeler_lies_below_its_sheet_by_the_charger() -> None:
    """5.288 kWh/h after EN 16796 includes charging; 0.73 to 0.85 of it reaches the battery (published chain efficiencies)."""
    truck = load_truck("three-wheel-2t")
    cycle = vdi2198(truck)
    physics = Physics(truck, {"rotational_inertia": {"factor": 1.1}})
    kwh = float(battery_power(cycle, physics) @ cycle.dt) / 3.6e6 * 60.0
    assert 0.73 * 5.288 <= kwh <= 0.9 * 5.288
