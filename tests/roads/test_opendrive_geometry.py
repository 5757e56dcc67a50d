"""Reference lines against certified numbers (Fresnel integrals and quadrature agree on them to 1e-9)."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from fleetlog.core.network import distance_to_segment
from fleetlog.core.site import MapFrame
from fleetlog.roads.formats import _odr_geometry as geo


def end(curve, length, x=0.0, y=0.0, heading=0.0):
    return at(curve, length, length, x, y, heading)


def at(curve, length, s, x=0.0, y=0.0, heading=0.0):
    plan = geo.Plan((geo.Piece(0.0, x, y, heading, length, curve),))
    return [float(v[0]) for v in plan.at(np.array([s]))]


CERTIFIED = [
    (geo.spiral(0.1, 0.1, math.pi / 2 / 0.1), math.pi / 2 / 0.1, (0, 0, 0), (10, 10, 1.570796)),
    (geo.spiral(-0.05, -0.05, 20), 20, (1, 2, 0.3), (19.794757878, -1.809886037, -0.7)),
    (geo.spiral(0.0, 0.1, 20), 20, (0, 0, 0), (18.090484758, 6.205366034, 1.0)),
    (geo.spiral(-0.2, -0.05, 10), 10, (0, 0, 0), (6.817787288, -6.394877300, -1.25)),
    (geo.spiral(0.05, -0.05, 30), 30, (0, 0, 0.5), (21.810745845, 20.324897650, 0.5)),
    (
        geo.spiral(0.16627793039047342, 0.017152606609492665, 7.532431203846809), 7.532431203846809,
        (161.18988482560962, 43.5498200468719, 2.734621064075011), (153.816713768, 43.307779806, 3.425460014),
    ),
]  # fmt: skip


@pytest.mark.parametrize("curve, length, start, expected", CERTIFIED)
def test_certified_ends(curve, length, start, expected):
    assert end(curve, length, *start) == pytest.approx(expected, abs=1e-6)


U, V, TRUE_LENGTH = np.array([0.0, 10, 0, 0]), np.array([0.0, 0, 6, -4]), 10.236033813


@pytest.mark.parametrize("kind", ["normalized", "arcLength"])
@pytest.mark.parametrize(
    "p, expected",
    [
        (0.25, (7.38808228, 5.80294413, 0.42131444)),
        (0.5, (9.70166356, 6.97341323, 0.49145679)),
        (1.0, (14.40332712, 8.94682646, 0.2)),
    ],
)
def test_certified_param_poly3(kind, p, expected):
    scale = TRUE_LENGTH ** np.arange(4) if kind == "arcLength" else np.ones(4)
    span = TRUE_LENGTH if kind == "arcLength" else 1.0
    curve = geo.param_poly3(U / scale, V / scale, TRUE_LENGTH, span)
    passed = quad(lambda q: math.hypot(10, 12 * q - 12 * q * q), 0, p)[0]
    assert at(curve, TRUE_LENGTH, passed, 5, 5, 0.2) == pytest.approx(expected, abs=2e-4)


def test_param_poly3_goes_by_arc_length_and_not_by_its_parameter():
    curve = geo.param_poly3(U, V, TRUE_LENGTH, 1.0)
    u, _, _ = curve(np.array([2.5246]))
    assert u[0] == pytest.approx(2.5, abs=1e-3)


def test_u_of_a_poly3_is_not_s():
    # v = 0.01 u^2: u = 20 is already 20.52 m of road
    curve = geo.poly3(np.array([0, 0, 0.01, 0]), 20.0)
    u, v, _ = curve(np.array([20.0]))
    assert u[0] < 19.6 and v[0] == pytest.approx(0.01 * u[0] ** 2, rel=1e-3)
    assert quad(lambda t: math.hypot(1, 0.02 * t), 0, u[0])[0] == pytest.approx(20.0, abs=1e-3)


def test_header_offset_is_added():
    x, y = MapFrame("header", (297133.4, 5623440.5), 0.0).to_site(np.array([100.0]), np.array([50.0]))
    assert (x[0], y[0]) == pytest.approx((297233.4, 5623490.5))
    x, y = MapFrame("header", (10.0, 20.0), math.pi / 2).to_site(np.array([100.0]), np.array([50.0]))
    assert (x[0], y[0]) == pytest.approx((-40.0, 120.0))


curvatures = st.floats(-0.2, 0.2)


@given(curvatures, curvatures, st.floats(0.5, 60))
@settings(deadline=None)
def test_every_curve_is_as_long_as_it_says(start, stop, length):
    s = np.linspace(0, length, 2001)
    for curve in (
        geo.spiral(0.0, 0.0, length),
        geo.spiral(start, start, length),
        geo.spiral(start, stop, length),
    ):
        u, v, _ = curve(s)
        assert np.hypot(np.diff(u), np.diff(v)).sum() == pytest.approx(length, rel=1e-4)


@given(curvatures, st.floats(-1e-9, 1e-9), st.floats(1, 60))
@settings(deadline=None)
def test_a_spiral_of_equal_ends_is_an_arc(curvature, change, length):
    ds = np.array([length / 3, length])
    turn = curvature * ds
    half = np.sinc(turn / (2 * np.pi)) * ds
    arc = half * np.cos(turn / 2), half * np.sin(turn / 2), turn
    for a, b in zip(geo.spiral(curvature, curvature + change, length)(ds), arc, strict=True):
        assert np.allclose(a, b, atol=1e-5)


@given(curvatures, curvatures, st.floats(1, 60))
@settings(deadline=None)
def test_a_spiral_driven_backwards_is_the_spiral_with_swapped_and_negated_ends(start, stop, length):
    x, y, h = end(geo.spiral(start, stop, length), length)
    back = end(geo.spiral(-stop, -start, length), length, x, y, h + math.pi)
    assert back[:2] == pytest.approx((0, 0), abs=1e-8)
    assert back[2] == pytest.approx(math.pi, abs=1e-9)


@given(curvatures, curvatures, st.floats(1, 80), st.sampled_from([0.005, 0.05, 0.5]))
@settings(deadline=None)
def test_sampled_chords_stay_within_the_tolerance(start, stop, length, tolerance):
    curve = geo.spiral(start, stop, length)

    def points(s):
        u, v, _ = curve(s)
        return np.column_stack([u, v, np.zeros(len(s))])

    s = geo.sample(points, np.array([0.0, length]), tolerance)
    fine = np.linspace(0, length, 3001)
    true, kept = points(fine), points(s)
    k = np.clip(np.searchsorted(s, fine, side="right") - 1, 0, len(s) - 2)
    assert distance_to_segment(true, kept[k], kept[k + 1]).max() < 1.3 * tolerance
