"""Truck files: defaults, and errors that name what is meant."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.truck import load_truck, truck_from_dict, truck_to_dict
from fleetlog.errors import TruckError


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
