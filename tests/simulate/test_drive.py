"""Laws of the speed profile."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.motion import Motion
from fleetlog.core.truck import truck_from_dict
from fleetlog.physics.motion.legs import Leg, free_flow
from fleetlog.physics.power import Physics


def truck(**drive):
    return truck_from_dict({"chassis": {"mass": 4900.0}, "drive": drive})


def speed_profile(distance, limit, truck, stops=(), **path):
    """How a truck drives a path of nodes with a limit at each."""
    n = len(distance)
    leg = Leg(distance, Motion.of(n, **path), np.arange(n), np.nan, True, dict(stops))
    return free_flow(leg, Physics(truck), np.broadcast_to(limit, n))


STRONG = truck(max_power=1e9)
limits = st.lists(st.floats(0.5, 6.0), min_size=20, max_size=60)


@given(limits, st.lists(st.floats(-0.5, 0.5), min_size=60, max_size=60))
@settings(max_examples=60, deadline=None)
def test_no_limit_is_broken(limit, bend):
    n = len(limit)
    t = truck()
    s = np.arange(n) * 0.7
    k = np.array(bend[:n])
    p = speed_profile(s, np.array(limit), t, curvature=k)
    assert (p.speed <= np.array(limit) + 1e-9).all()
    assert (p.speed**2 * np.abs(k) <= t.drive.max_lateral_acceleration + 1e-9).all()
    a = np.diff(p.speed**2) / (2 * np.diff(s))
    assert a.max() <= t.drive.max_acceleration + 1e-9
    assert a.min() >= -t.drive.max_deceleration - 1e-9
    assert p.speed[0] == p.speed[-1] == 0.0
    assert (np.diff(p.time) > 0).all()


@given(limits)
@settings(max_examples=40, deadline=None)
def test_driven_backwards_with_swapped_limits_it_is_the_same_drive(limit):
    n = len(limit)
    s = np.arange(n) * 0.7
    swapped = dataclasses.replace(
        STRONG, drive=dataclasses.replace(STRONG.drive, max_acceleration=0.8, max_deceleration=0.6)
    )
    there = speed_profile(s, np.array(limit), STRONG)
    back = speed_profile(s, np.array(limit)[::-1], swapped)
    np.testing.assert_allclose(there.speed, back.speed[::-1], atol=1e-9)
    assert there.duration == pytest.approx(back.duration)


@given(limits, st.integers(0, 19), st.floats(0.1, 3.0))
@settings(max_examples=40, deadline=None)
def test_a_higher_limit_never_slows(limit, where, more):
    s = np.arange(len(limit)) * 0.7
    higher = np.array(limit)
    higher[where] += more
    assert (
        speed_profile(s, higher, truck()).speed >= speed_profile(s, np.array(limit), truck()).speed - 1e-9
    ).all()


def test_thirty_metres_take_what_the_formula_says():
    # t = L / v + v / 2 (1 / a + 1 / d), for a trapezoid
    t = truck(max_power=1e9, max_acceleration=0.5, max_deceleration=0.8)
    p = speed_profile(np.linspace(0.0, 30.0, 3001), 4.2, t)
    assert p.duration == pytest.approx(30 / 4.2 + 4.2 / 2 * (1 / 0.5 + 1 / 0.8), rel=1e-3)


def test_power_limits_the_climb():
    t = truck(max_power=10800.0, max_acceleration=5.0)
    p = speed_profile(np.linspace(0.0, 200.0, 4001), 5.0, t, slope=np.arctan(0.1), payload=1000.0)
    force = 5900.0 * 9.81 * (0.015 * np.cos(np.arctan(0.1)) + np.sin(np.arctan(0.1)))
    assert p.speed.max() == pytest.approx(10800.0 / force, rel=1e-3)


def test_a_stop_is_made_and_waited_at():
    p = speed_profile(np.arange(101.0), 3.0, truck(), stops={50: 20.0})
    assert p.speed[50] == 0.0
    without = speed_profile(np.arange(101.0), 3.0, truck())
    assert p.duration > without.duration + 20.0
    s, v, a = p.at(p.time[50] + 10.0)
    assert (float(s), float(v), float(a)) == (50.0, 0.0, 0.0)


def test_motion_read_back_in_time_covers_the_path():
    p = speed_profile(np.arange(0.0, 60.5, 0.5), 4.0, truck(), stops={40: 5.0})
    t = np.linspace(0.0, p.duration, 20001)
    s, v, a = p.at(t)
    assert np.trapezoid(v, t) == pytest.approx(60.0, rel=1e-4)
    assert (np.diff(s) >= -1e-9).all()
    assert np.trapezoid(a, t) == pytest.approx(0.0, abs=0.02)
