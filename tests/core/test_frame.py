"""The site frame against the ellipsoid itself (pyproj's geodesics)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from fleetlog.core.site import Frame

GEOD = Geod(ellps="WGS84")


@given(
    latitude=st.floats(-75, 75),
    longitude=st.floats(-179, 179),
    rotation=st.floats(-3.2, 3.2),
    x=st.floats(-2000, 2000),
    y=st.floats(-2000, 2000),
)
def test_distance_and_azimuth_from_the_origin_are_the_geodesic_ones(latitude, longitude, rotation, x, y):
    frame = Frame(latitude, longitude, rotation)
    lat, lon = frame.to_geographic(x, y)
    azimuth, _, distance = GEOD.inv(longitude, latitude, float(lon), float(lat))
    assert distance == pytest.approx(np.hypot(x, y), abs=1e-3)
    if distance > 1:
        east_of_x = np.arctan2(y, x) + rotation
        assert np.cos(np.radians(90 - azimuth) - east_of_x) == pytest.approx(1, abs=1e-6)


@given(
    st.floats(-60, 60), st.floats(-179, 179), st.floats(-5000, 5000), st.floats(-5000, 5000), st.floats(-3, 3)
)
def test_there_and_back(latitude, longitude, x, y, rotation):
    # PROJ returns the origin itself within 1e-10 rad of it, 0.64 mm.
    frame = Frame(latitude, longitude, rotation)
    assert np.allclose(frame.to_local(*frame.to_geographic(x, y)), (x, y), atol=1e-3)


def test_north_is_up_and_east_is_right():
    x, y = Frame(50.0, 9.0).to_local([50.001, 50.0], [9.0, 9.001])
    assert y[0] > 100 and abs(x[0]) < 1e-6
    assert x[1] > 50 and abs(y[1]) < 1e-2
