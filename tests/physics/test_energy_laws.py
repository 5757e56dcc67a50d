"""Laws that the energy of a motion obeys, whatever the motion."""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.motion import Motion, join
from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.truck import SECTIONS, Chassis, Truck, load_truck
from fleetlog.physics import formulas
from fleetlog.physics.cycles import legs, vdi_pieces
from fleetlog.physics.field import Field, stretches
from fleetlog.physics.power import Own, Physics, all_terms, battery_power, ledger, soc_change, term_forces

TRUCK = load_truck("three-wheel-2t")
RICH = {
    "surface_resistance": {"factor": 1.4}, "wind": {"wind_east": 4.0, "wind_north": -2.0}, "cornering_resistance": {"k": 0.03},
    "viscous_drag": {"coefficient": 20.0}, "brake_drag": {"brake_force": 120.0}, "rotational_inertia": {"factor": 1.1}, "payload": {"factor": 1.2},
    "drivetrain_efficiency": {"efficiency": 0.7}, "regeneration": {"regeneration": 0.4}, "grade": {"slope": 0.01},
    "thermal_load": {"heating": 60.0, "cooling": 30.0, "threshold": 12.0}, "auxiliary_load": {"power": 500.0},
}  # fmt: skip


def motions(seed: int, n: int = 300) -> Motion:
    """Any motion."""
    rng = np.random.default_rng(seed)
    speed = np.maximum(rng.normal(2.0, 2.0, n), 0.0)
    return Motion.of(
        n, dt=rng.uniform(0.05, 2.0, n), speed=speed, acceleration=rng.normal(0, 0.5, n) * (speed > 0),
        slope=rng.normal(0, 0.04, n), curvature=rng.normal(0, 0.2, n), heading=rng.uniform(-np.pi, np.pi, n),
        payload=rng.choice([0.0, 800.0, 2000.0], n), lift_speed=rng.choice([0.0, 0.3, -0.4], n),
        ambient_temperature=rng.uniform(-10, 35, n), x=rng.uniform(0, 90, n), y=rng.uniform(0, 90, n),
    )  # fmt: skip


def energy(motion: Motion, physics: Physics) -> float:
    return float(battery_power(motion, physics) @ motion.dt)


seeds = st.integers(0, 10_000)


@given(seeds, st.lists(st.integers(0, 300), max_size=6))
def test_energy_adds_up_over_any_split(seed: int, cuts: list[int]) -> None:
    motion, physics = motions(seed), Physics(TRUCK, RICH)
    edges = [0, *sorted(cuts), len(motion)]
    parts = sum(energy(motion[a:b], physics) for a, b in itertools.pairwise(edges) if b > a)
    assert parts == pytest.approx(energy(motion, physics), rel=1e-10)


@given(seeds, st.integers(0, 300))
def test_what_holds_from_a_time_on_is_the_sum_of_before_and_after(seed: int, change: int) -> None:
    motion = motions(seed).replaced(time=np.arange(300.0))
    new = {"drivetrain_efficiency": {"efficiency": 0.6}, "viscous_drag": {"coefficient": 50.0}}
    plain = Physics(TRUCK, RICH)
    timed = replace(plain, own=(Own(new, None, float(change)),))
    parts = [(motion[:change], plain), (motion[change:], plain.changed(new))]
    expected = sum(energy(m, p) for m, p in parts if len(m))
    assert energy(motion, timed) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_a_drift_comes_in_evenly_and_concerns_its_vehicles_alone() -> None:
    still = Motion.of(101, dt=1.0, time=np.arange(101.0) + 50.0)
    load = {"auxiliary_load": {"power": 900.0}}
    physics = Physics(TRUCK, own=(Own(load, ("T1",), 1000.0 + 50.0, 1000.0 + 150.0, True),))
    others = battery_power(still, physics.of("T2", 1000.0))
    drifting = battery_power(still, physics.of("T1", 1000.0))
    np.testing.assert_allclose(others, TRUCK.auxiliary.power)
    np.testing.assert_allclose(drifting, np.linspace(TRUCK.auxiliary.power, 900.0, 101))


@given(seeds)
def test_the_ledger_adds_up_to_the_total(seed: int) -> None:
    motion, physics = motions(seed), Physics(TRUCK, RICH)
    rows = ledger(motion, physics)
    assert set(rows) >= {
        "inertia",
        "grade",
        "rolling_resistance",
        "wind",
        "lift_efficiency",
        "auxiliary_load",
    }
    assert np.allclose(sum(rows.values()), battery_power(motion, physics), rtol=1e-12)
    # ... and the total is the formula of the contract, written out once more.
    plain = Physics(TRUCK.with_value("resistance.drag_area", 2.0))
    t, m = plain.truck, 3575.0 + motion.payload
    force = m * motion.acceleration + 0.015 * m * 9.81 * np.cos(motion.slope) * (motion.speed > 0)
    force = force + m * 9.81 * np.sin(motion.slope) + 0.5 * 1.2 * 2.0 * motion.speed**2
    work = force * motion.speed
    power = np.where(work >= 0, work / t.drive.efficiency, work * t.drive.regeneration) + t.auxiliary.power
    lifting = (motion.payload + t.lift.carriage_mass) * 9.81 * motion.lift_speed
    power = power + np.where(lifting > 0, lifting / t.lift.efficiency, lifting * t.lift.recuperation)
    assert np.allclose(battery_power(motion, plain), power, rtol=1e-12)


@given(seeds, st.floats(-np.pi, np.pi), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_moving_and_turning_the_site_changes_nothing(seed: int, angle: float, dx: float, dy: float) -> None:
    motion = motions(seed)
    c, s = np.cos(angle), np.sin(angle)
    moved = motion.replaced(
        x=c * motion.x - s * motion.y + dx, y=s * motion.x + c * motion.y + dy, heading=motion.heading + angle
    )
    blows = RICH["wind"]
    east, north = blows["wind_east"], blows["wind_north"]
    turned = {**RICH, "wind": {"wind_east": c * east - s * north, "wind_north": s * east + c * north}}
    before, after = energy(motion, Physics(TRUCK, RICH)), energy(moved, Physics(TRUCK, turned))
    assert after == pytest.approx(before, rel=1e-9)


def test_a_field_moves_with_the_site() -> None:
    def site(angle: float) -> tuple[Motion, Field]:
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        out = Edge(
            "a", "1", "2", np.array([[0.0, 0, 0], [60, 10, 0], [100, 0, 0]]) @ turn.T + [5.0, 7.0, 0.0], "a"
        )
        network = build_network([out, reversed_edge(out)], has_elevation=False)
        offset = np.linspace(0, network.length[0], 50)
        edge = np.zeros(50, np.int32)
        place = network.position(edge, offset)
        motion = Motion.of(50, edge=edge, edge_offset=offset, x=place[:, 0], y=place[:, 1], speed=2.0)
        starts = np.array([10.0, 50.0])
        return motion, stretches(
            network, np.zeros(2, np.int32), starts, starts + 20.0, np.array([0.03, -0.02])
        )

    answers = []
    for angle in (0.0, 2.1):
        motion, field = site(angle)
        answers.append(energy(motion, Physics(TRUCK, fields={"grade": field})))
    assert answers[0] == pytest.approx(answers[1], rel=1e-12)
    assert answers[0] != pytest.approx(energy(motion, Physics(TRUCK)), rel=1e-6)


@given(st.integers(0, 1000), st.floats(0.5, 5.0), st.floats(0.0, 2000.0))
def test_a_closed_loop_without_losses_costs_only_what_dissipates(
    seed: int, speed: float, load: float
) -> None:
    rng = np.random.default_rng(seed)
    n, step = 400, 0.5
    rise = rng.normal(0, 0.03, n)
    rise -= rise.mean()  # sin(theta) of each step: the loop ends at the height where it began
    truck = TRUCK.with_value("drive.efficiency", 1.0).with_value("drive.regeneration", 1.0)
    motion = Motion.of(n, dt=step / speed, speed=speed, slope=np.arcsin(rise), payload=load)
    rows = ledger(motion, Physics(truck))
    assert rows["grade"] @ motion.dt == pytest.approx(0.0, abs=1e-6 * abs(rows["grade"] * motion.dt).sum())
    mass, length = 3575.0 + load, n * step
    rolling = 0.015 * mass * 9.81 * step * np.cos(np.arcsin(rise)).sum()
    drag = 0.5 * 1.2 * 3.5 * speed**2 * length
    assert energy(motion, Physics(truck)) == pytest.approx(rolling + drag + 250.0 * length / speed, rel=1e-9)


def test_nothing_but_auxiliary_acts_at_rest() -> None:
    rng = np.random.default_rng(1)
    n = 50
    still = Motion.of(
        n,
        slope=rng.normal(0, 0.1, n),
        curvature=rng.normal(0, 1, n),
        heading=rng.uniform(-3, 3, n),
        payload=1500.0,
    )
    values = {k: v for k, v in RICH.items() if k != "thermal_load"}
    rows = ledger(still, Physics(TRUCK, values))
    for name, watts in rows.items():
        assert np.all(watts == (500.0 if name == "auxiliary_load" else 0.0)), name


@given(seeds, st.floats(100.0, 3000.0))
def test_doubling_the_load_changes_what_has_mass_in_it_and_nothing_else(seed: int, load: float) -> None:
    motion = motions(seed)
    values = {k: v for k, v in RICH.items() if k != "payload"}
    none, once, twice = (
        term_forces(motion.replaced(payload=np.full(len(motion), p)), Physics(TRUCK, values))
        for p in (0.0, load, 2 * load)
    )
    without_mass = {"aerodynamic_drag", "wind", "viscous_drag", "brake_drag"}
    for name in none:
        assert np.allclose(twice[name] - once[name], once[name] - none[name], rtol=1e-9, atol=1e-7), name
        changed = bool(np.any(once[name] != none[name]))
        assert changed == (name not in without_mass), name
        if changed:  # in proportion to the mass
            assert np.allclose(twice[name] * (3575.0 + load), once[name] * (3575.0 + 2 * load), atol=1e-5), (
                name
            )


# ---- units: change the base units, and every result must change as its dimension says (Buckingham)

DIMENSIONS = {  # kilogram, metre, second, kelvin, ampere
    "1": (0, 0, 0, 0, 0), "rad": (0, 0, 0, 0, 0), "kg": (1, 0, 0, 0, 0), "m": (0, 1, 0, 0, 0), "m2": (0, 2, 0, 0, 0),
    "1/m": (0, -1, 0, 0, 0), "s": (0, 0, 1, 0, 0), "m/s": (0, 1, -1, 0, 0), "m/s2": (0, 1, -2, 0, 0), "N": (1, 1, -2, 0, 0),
    "N s/m": (1, 0, -1, 0, 0), "W": (1, 2, -3, 0, 0), "Wh": (1, 2, -2, 0, 0), "W/K": (1, 2, -3, -1, 0), "W/N2": (-1, 0, 1, 0, 0),
    "degC": (0, 0, 0, 1, 0), "V": (1, 2, -3, 0, -1), "ohm": (1, 2, -3, 0, -2), "kg/m3": (1, -3, 0, 0, 0),
}  # fmt: skip
MOTION_UNITS = {
    "time": "s", "dt": "s", "speed": "m/s", "acceleration": "m/s2", "slope": "rad", "curvature": "1/m", "heading": "rad",
    "payload": "kg", "lift_speed": "m/s", "fork_height": "m", "x": "m", "y": "m", "edge_offset": "m",
    "ambient_temperature": "degC", "soc": "1", "power": "W",
}  # fmt: skip
RESULT_UNITS = {"force": "N", "power": "W", "drive": "W", "load": "kg", "speed": "m/s"}
CONSTANTS = {"GRAVITY": "m/s2", "AIR_DENSITY": "kg/m3", "LADEN": "kg"}


@pytest.mark.parametrize("name", sorted(n for n, t in all_terms().items() if t.function is not None))
def test_every_term_has_the_dimension_of_what_it_says(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    base = (3.0, 0.2, 7.0, 0.5, 11.0)

    def factor(unit: str) -> float:
        return float(np.prod(np.power(base, DIMENSIONS[unit])))

    def truck(scale: bool) -> Truck:
        out = load_truck("three-wheel-2t").with_value("battery.internal_resistance", 0.01)
        for section, kind in SECTIONS.items():
            for f in fields(kind):
                key = f"{section}.{f.name}"
                out = out.with_value(key, out.value(key) * (factor(f.metadata["unit"]) if scale else 1.0))
        return out

    term = all_terms()[name]
    assert term.function is not None
    motion = motions(7).replaced(power=np.linspace(-5000, 9000, 300))
    scaled = motion.replaced(**{k: getattr(motion, k) * factor(u) for k, u in MOTION_UNITS.items()})
    values = {p.name: 0.3 * p.low + 0.7 * p.high for p in term.parameters}
    rescaled = {p.name: values[p.name] * factor(p.unit) for p in term.parameters}
    force = np.linspace(-4000.0, 6000.0, len(motion)) if term.acts == "drive" else None
    if force is not None:
        values, rescaled = {**values, "force": force}, {**rescaled, "force": force * factor("N")}
    plain = term.function(motion, truck(False), values)
    module = importlib.import_module(term.function.__module__)
    for constant, unit in CONSTANTS.items():
        if hasattr(module, constant):
            monkeypatch.setattr(module, constant, getattr(module, constant) * factor(unit))
    after = term.function(scaled, truck(True), rescaled)
    assert np.any(plain != 0.0)
    assert np.allclose(after, plain * factor(RESULT_UNITS[term.acts]), rtol=1e-9, atol=0.0, equal_nan=True)


# ---- closed formulas


def test_every_formula_is_that_of_one_term_and_calls_no_other() -> None:
    tree, terms = ast.parse(inspect.getsource(formulas)), all_terms()
    own = {f.name for f in tree.body if isinstance(f, ast.FunctionDef)}
    assert all(terms[name].function is getattr(formulas, name) for name in own)
    assert not own & {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    assert all(t.function is not None or t.law for t in terms.values())


@given(st.floats(0.2, 5.0), st.floats(0.0, 2500.0), st.floats(0.0, 0.05))
def test_power_at_constant_speed_is_the_closed_formula(speed: float, load: float, grade: float) -> None:
    motion = Motion.of(1, speed=speed, payload=load, slope=np.arctan(grade))
    m, theta = 3575.0 + load, np.arctan(grade)
    force = m * 9.81 * (0.015 * np.cos(theta) + np.sin(theta)) + 0.5 * 1.2 * 3.5 * speed**2
    assert battery_power(motion, Physics(TRUCK))[0] == pytest.approx(force * speed / 0.72 + 250.0, rel=1e-12)


@given(st.floats(0.2, 5.0), st.floats(0.0, 2500.0), st.floats(-0.1, 0.1), st.floats(1e-5, 1e-3))
def test_copper_loss_goes_by_all_forces_at_the_wheel(
    speed: float, load: float, grade: float, k: float
) -> None:
    motion = Motion.of(1, speed=speed, payload=load)
    physics = Physics(TRUCK, {"grade": {"slope": grade}, "viscous_drag": {"coefficient": 80.0}})
    force = sum(term_forces(motion, physics).values())[0]
    warm = physics.changed({"copper_loss": {"k": k}})
    lost = battery_power(motion, warm)[0] - battery_power(motion, physics)[0]
    assert lost == pytest.approx(k * force**2, rel=1e-9)


def test_an_enabled_drive_is_that_of_its_own_truck() -> None:
    driving, standing = Motion.of(5, speed=1.0), Motion.of(5, vehicle=1)
    physics = Physics(TRUCK, {"enabled_load": {"power": 100.0, "hold": 2.0}})
    both, stopped = join([driving, standing]), join([driving, Motion.of(5, time=np.arange(5.0, 10.0))])
    assert ledger(both, physics)["enabled_load"].tolist() == [100.0] * 5 + [0.0] * 5
    assert ledger(stopped, physics)["enabled_load"].tolist() == [100.0] * 7 + [0.0] * 3


def test_a_coasting_truck_draws_auxiliary_power_only() -> None:
    n = 400
    speed = np.linspace(3.0, 0.5, n)
    resisting = 0.015 * 9.81 + 0.5 * 1.2 * 3.5 * speed**2 / 3575.0
    motion = Motion.of(n, speed=speed, acceleration=-resisting)
    assert np.allclose(battery_power(motion, Physics(TRUCK)), 250.0, atol=1e-8)


def test_state_of_charge_follows_the_contract() -> None:
    truck = replace(TRUCK, chassis=Chassis(1000.0)).with_value("battery.internal_resistance", 0.02)
    power = np.array([-3000.0, 0.0, 12000.0])
    cell = power + 0.02 * (power / 48.0) ** 2
    assert soc_change(power, np.full(3, 2.0), truck) == pytest.approx(
        -cell * 2.0 / (3600.0 * 19440.0), rel=1e-14
    )


# ---- the VDI 2198 cycle: figures computed independently (docs/proof_energy.md)

SHEET = load_truck("three-wheel-2t").with_value("resistance.drag_area", 0.0)


def kwh_per_hour(truck: Truck, load: float | None = None, **how: float) -> float:
    cycle = legs(vdi_pieces(truck, **how), truck.chassis.rated_load if load is None else load)
    assert cycle.dt.sum() == pytest.approx(60.0)
    assert cycle.speed @ cycle.dt == pytest.approx(60.0, rel=1e-6)
    return energy(cycle, Physics(truck, {"rotational_inertia": {"factor": 1.1}})) / 3.6e6 * 60.0


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("resistance.rolling", 0.015, 4.60), ("resistance.rolling", 0.010, 4.29), ("resistance.rolling", 0.025, 5.21),
        ("drive.efficiency", 0.60, 5.19), ("drive.efficiency", 0.85, 4.14), ("drive.regeneration", 0.0, 5.32),
        ("lift.efficiency", 0.50, 5.10), ("lift.efficiency", 0.75, 4.23), ("auxiliary.power", 600.0, 4.95),
        ("lift.recuperation", 0.4, 4.07),
    ],
)  # fmt: skip
def test_the_vdi_cycle_costs_what_was_computed_for_it(key: str, value: float, expected: float) -> None:
    assert kwh_per_hour(SHEET.with_value(key, value)) == pytest.approx(expected, abs=0.006)


def test_the_vdi_cycle_of_other_trucks() -> None:
    assert kwh_per_hour(SHEET, speed=4.0) == pytest.approx(5.10, abs=0.006)
    efg220 = SHEET.with_value("chassis.mass", 3366.0)
    assert kwh_per_hour(efg220) == pytest.approx(4.51, abs=0.006)
    efg213 = SHEET.with_value("chassis.mass", 2692.0)
    assert kwh_per_hour(efg213, load=1300.0) == pytest.approx(3.33, abs=0.006)
    # A 5 t truck with 3 t: computed as 6.93 without saying what carriage and auxiliary power it was given.
    heavy = SHEET.with_value("chassis.mass", 5000.0)
    assert kwh_per_hour(heavy, load=3000.0, speed=3.5) == pytest.approx(6.93, rel=0.03)
