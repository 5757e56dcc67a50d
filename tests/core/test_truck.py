"""Truck files: defaults, and errors that name what is meant."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Chassis, Truck, Watched, load_truck, truck_from_dict, truck_to_dict
from fleetlog.errors import TruckError
from fleetlog.physics.power import all_terms


@given(st.floats(500, 9000), st.floats(0.1, 1.0))
def test_round_trip(mass, efficiency):
    t = truck_from_dict({"chassis": {"mass": mass}, "drive": {"efficiency": efficiency}})
    assert truck_from_dict(truck_to_dict(t)) == t


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"chassis": {"mass": 1000, "masss": 1}}, "chassis.masss: unknown key; did you mean 'mass'"),
        ({"chasis": {"mass": 1000}}, "did you mean 'chassis'"),
        ({}, "mass is missing"),
        ({"chassis": {"mass": "heavy"}}, "not a number"),
        ({"chassis": {"mass": 1000}, "drive": {"efficiency": 1.7}}, "outside"),
    ],
)
def test_one_clear_line(data, message):
    with pytest.raises(TruckError, match=message) as error:
        truck_from_dict(data, "truck.toml")
    assert "\n" not in error.value.line() and error.value.line().startswith("truck.toml")


def test_missing_file(tmp_path):
    with pytest.raises(TruckError, match="no such file"):
        load_truck(tmp_path / "none.toml")


def test_real_truck_files(shared_data):
    for path in sorted(shared_data.glob("blind/*/truck.toml")):
        assert load_truck(path).chassis.mass > 3000


@pytest.mark.parametrize("name", [n for n, t in all_terms().items() if t.function is not None])
def test_what_a_term_reads_of_a_truck_is_what_it_depends_on(name: str) -> None:
    """A term returns the same for every truck whose sections it does not read."""
    term = all_terms()[name]
    assert term.function is not None
    values = {p.name: 0.5 * (p.low + min(p.high, 10.0)) for p in term.parameters if not p.truck_key}
    given = values | ({"force": 100.0} if term.acts == "drive" else {})
    motion = Motion.of(
        4, speed=np.array([0.0, 1.0, 2.0, 1.0]), acceleration=np.array([0.0, 0.5, 0.0, -0.5]), payload=np.full(4, 300.0),
        lift_speed=np.array([0.3, 0.0, 0.0, -0.3]), curvature=np.array([0.0, 0.0, 0.3, 0.3]), time=np.arange(4.0),
    )  # fmt: skip
    nominal = Truck(Chassis(4000.0))
    watched = Watched(**vars(nominal))
    told = term.function(motion, watched, given)
    for f in fields(nominal):
        section = getattr(nominal, f.name)
        if is_dataclass(section) and f.name not in watched.read:
            twice = {g.name: 2.0 * getattr(section, g.name) for g in fields(section)}
            other = replace(nominal, **{f.name: replace(section, **twice)})
            assert np.array_equal(term.function(motion, other, given), told)
