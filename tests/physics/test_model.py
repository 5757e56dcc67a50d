"""The physics on disk, and fields along a motion."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.core.motion import Motion
from fleetlog.core.network import Edge, Network, build_network, reversed_edge
from fleetlog.core.truck import Chassis, Truck
from fleetlog.errors import InputError
from fleetlog.physics.field import Field, stretches
from fleetlog.physics.model import load_physics, save_physics
from fleetlog.physics.power import Own, Physics, all_terms, allowed_speed, battery_power

TRUCK = Truck(Chassis(4000.0), name="t")

VOCABULARY = {
    "grade", "surface_resistance", "rolling_resistance", "aerodynamic_drag", "wind", "cornering_resistance",
    "viscous_drag", "rotational_inertia", "payload", "drivetrain_efficiency", "regeneration", "lift_efficiency",
    "auxiliary_load", "thermal_load", "battery_resistance", "speed_zone", "cornering_speed", "laden_speed",
    "acceleration_limit", "waiting", "clock_offset", "speed_scale",
}  # fmt: skip


def road() -> Network:
    """A level road of 100 m east and its way back, then 50 m north, one way."""
    out = Edge("a", "1", "2", np.array([[0.0, 0, 0], [100, 0, 0]]), "a")
    north = Edge("b", "2", "3", np.array([[100.0, 0, 0], [100, 50, 0]]), "b")
    return build_network([out, reversed_edge(out), north], has_elevation=False)


def on(network: Network, edge_id: str, offset: list[float]) -> Motion:
    edge = network.edge(edge_id)
    n = len(offset)
    place = network.position(np.full(n, edge, np.int32), np.array(offset))
    heading = network.heading(np.full(n, edge, np.int32), np.array(offset))
    return Motion.of(
        n, edge=edge, edge_offset=offset, x=place[:, 0], y=place[:, 1], heading=heading, speed=2.0
    )


def grade_field(network: Network) -> Field:
    edge = np.array([network.edge("a")] * 2, np.int32)
    return stretches(network, edge, np.array([10.0, 40.0]), np.array([40.0, 60.0]), np.array([0.02, 0.05]))


def test_every_term_of_the_vocabulary_is_a_file() -> None:
    assert set(all_terms()) >= VOCABULARY
    for name, term in all_terms().items():
        assert term.name == name
        only_truck = bool(term.parameters) and all(p.truck_key for p in term.parameters)
        assert term.function is not None or term.acts in ("wait", "traffic", "sensor") or only_truck, name
        for p in term.parameters:
            assert p.low <= p.nominal(TRUCK) <= p.high, (name, p.name)


def test_every_added_term_at_its_neutral_value_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    n = 500
    motion = Motion.of(
        n, speed=rng.uniform(0, 5, n), acceleration=rng.normal(0, 0.5, n), slope=rng.normal(0, 0.05, n),
        curvature=rng.normal(0, 0.2, n), payload=rng.uniform(0, 2000, n), lift_speed=rng.normal(0, 0.2, n),
        heading=rng.uniform(-3, 3, n), ambient_temperature=rng.uniform(-10, 30, n),
    )  # fmt: skip
    truck = TRUCK.with_value("resistance.drag_area", 4.0)
    plain = battery_power(motion, Physics(truck))
    for name, term in all_terms().items():
        values = {name: {p.name: p.nominal(truck) for p in term.parameters}}
        assert battery_power(motion, Physics(truck, values)) == pytest.approx(plain, rel=1e-12), name


def test_a_field_is_looked_up_by_stretch() -> None:
    network = road()
    values = grade_field(network).along(
        on(network, "a", [0.0, 9.9, 10.1, 39.9, 40.1, 59.9, 60.1, 100.0]), 0.0
    )
    assert values.tolist() == [0, 0, 0.02, 0.02, 0.05, 0.05, 0, 0]


def test_without_a_map_the_nearest_stretch_of_the_same_heading_counts() -> None:
    network = road()
    motion = on(network, "a", [5.0, 25.0, 50.0, 80.0]).replaced(edge=np.full(4, -1, np.int32))
    assert grade_field(network).along(motion, 0.0).tolist() == [0, 0.02, 0.05, 0]
    backwards = motion.replaced(heading=np.full(4, np.pi))
    assert grade_field(network).along(backwards, 0.0).tolist() == [0, 0, 0, 0]


def test_a_model_survives_the_disk(tmp_path) -> None:
    network = road()
    physics = Physics(
        TRUCK, {"auxiliary_load": {"power": 661.0}, "wind": {"wind_east": 3.0, "wind_north": -1.0}},
        frozenset({"lift_efficiency"}), {"grade": grade_field(network)}, {"auxiliary_load": {"power": (640.0, 690.0)}},
    )  # fmt: skip
    save_physics(tmp_path, physics, network)
    read = load_physics(tmp_path, TRUCK, network)
    assert (read.values, read.off, read.intervals) == (physics.values, physics.off, physics.intervals)
    there = on(network, "a", np.linspace(0, 100, 41).tolist())
    assert battery_power(there, read).tolist() == battery_power(there, physics).tolist()
    assert load_physics(tmp_path / "model.toml", TRUCK, network).values == physics.values


@pytest.mark.parametrize(("term", "sign"), [("grade", -1.0), ("surface_resistance", 1.0)])
def test_the_way_back_has_the_same_surface_and_the_opposite_slope(tmp_path, term: str, sign: float) -> None:
    network = road()
    save_physics(tmp_path, Physics(TRUCK, fields={term: grade_field(network)}), network)
    field = load_physics(tmp_path, TRUCK, network).fields[term]
    there = field.along(on(network, "a", [20.0, 50.0]), 0.0)
    back = field.along(on(network, "-a", [80.0, 50.0]), 0.0)
    assert back.tolist() == (sign * there).tolist() == [sign * 0.02, sign * 0.05]


def test_a_rule_of_traffic_is_not_carried_to_the_way_back(tmp_path) -> None:
    network = road()
    save_physics(tmp_path, Physics(TRUCK, fields={"speed_zone": grade_field(network)}), network)
    assert len(load_physics(tmp_path, TRUCK, network).fields["speed_zone"]) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[term.grde]\nslope = 1.0", "did you mean 'grade'"),
        ("[term.auxiliary_load]\npwoer = 1.0", "did you mean 'power'"),
        ("[term.auxiliary_load]\npower = 'x'", "is not a number"),
        ("[term.auxiliary_load]\nfield = 'a.parquet'", "does not vary over the roads"),
        ("[term.grade]\nfield = 'fields/none.parquet'", "none.parquet is missing"),
        ("[terms.grade]\nslope = 0.1", "did you mean 'term'"),
        ("format_version = 2", "this fleetlog reads 1"),
        ("=", "not readable as TOML"),
    ],
)
def test_a_fault_in_a_model_is_one_clear_line(tmp_path, text: str, said: str) -> None:
    (tmp_path / "model.toml").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_physics(tmp_path, TRUCK, road())
    assert "model.toml" in caught.value.line()


def test_a_field_of_another_site_is_refused(tmp_path) -> None:
    network = road()
    save_physics(tmp_path, Physics(TRUCK, fields={"grade": grade_field(network)}), network)
    other = build_network([Edge("z", "1", "2", np.array([[0.0, 0, 0], [1, 0, 0]]), "z")])
    with pytest.raises(InputError, match="no edge 'a' on this site"):
        load_physics(tmp_path, TRUCK, other)


def test_the_lowest_of_the_allowed_speeds_counts() -> None:
    network = road()
    motion = on(network, "a", [5.0, 20.0, 50.0]).replaced(
        speed=np.full(3, 4.0), payload=np.array([0.0, 0.0, 500.0]), curvature=np.array([0.0, 1.2, 0.0])
    )
    field = stretches(network, np.array([0], np.int32), np.array([0.0]), np.array([10.0]), np.array([0.25]))
    physics = Physics(TRUCK, {"laden_speed": {"factor": 0.5}}, fields={"speed_zone": field})
    assert allowed_speed(motion, physics) == pytest.approx([1.0, 1.0, 2.0])


def test_what_some_vehicles_and_hours_have_of_their_own_is_read_as_written(tmp_path) -> None:
    own = (
        Own({"rolling_resistance": {"coefficient": 0.019}}, ("T3", "T4"), 1773478800.0),
        Own({"auxiliary_load": {"power": 700.0}}, None, 1773478800.0, 1773482400.0, True),
        Own({"mass": {"mass": 4200.0}}, ("T1",)),
    )
    save_physics(tmp_path, Physics(TRUCK, own=own))
    assert load_physics(tmp_path, TRUCK).own == own


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ("from = 2026-03-14T09:00:00", "has no time zone"),
        ("from = 2026-03-14T09:00:00Z\nuntil = 2026-03-14T08:00:00Z", "no time lies between"),
        ("drift = true", "no time lies between"),
        ("since = 3", "unknown key"),
        ("[own.term.rolling_resistance]\ncoeficient = 0.01", "did you mean 'coefficient'"),
    ],
)
def test_a_wrong_scope_is_named(lines: str, complaint: str, tmp_path) -> None:
    (tmp_path / "model.toml").write_text(f"[[own]]\n{lines}\n")
    with pytest.raises(InputError, match=complaint):
        load_physics(tmp_path, TRUCK)
