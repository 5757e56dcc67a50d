"""Speed and heading from positions: exact on a straight line, right on average with noise, zero at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from fleetlog.core.trajectory import Trajectory
from fleetlog.ingest.derive import (
    derive_motion,
    derive_power,
    fill_positions,
    fitted_motion,
    other_reading,
    pace_ratio,
    release_held,
    suspect_unit,
)
from fleetlog.store.trips import trip_ids


@settings(deadline=None)
@given(st.floats(0.5, 20.0), st.floats(-3.1, 3.1), st.floats(-1e6, 1e6), st.integers(0, 2**31))
def test_exact_on_a_straight_line_at_uneven_times(v: float, heading: float, away: float, seed: int) -> None:
    t = np.sort(np.random.default_rng(seed).uniform(0, 60, 200))
    speed, direction = fitted_motion(t, away + v * t * np.cos(heading), v * t * np.sin(heading) - away)
    assert speed == pytest.approx(np.full(200, v), rel=1e-3)
    assert np.abs(np.angle(np.exp(1j * (direction - heading)))).max() < 1e-3


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_error_against_raw_differences(rate: float) -> None:
    """With half a metre of noise the fit must be much nearer than differences are; at rest it must stand."""
    rng = np.random.default_rng(0)
    t = np.arange(0, 200, 1 / rate)
    true = np.where(t % 60 < 40, 3.0, 0.0)
    x = np.concatenate([[0], np.cumsum(true[1:] / rate)]) + rng.normal(0, 0.5, len(t))
    y = rng.normal(0, 0.5, len(t))
    speed, _ = fitted_motion(t, x, y)
    raw = np.hypot(np.gradient(x, t), np.gradient(y, t))
    inner = (np.abs(t % 60 - 40) > 3) & (t % 60 > 3)
    fitted, plain = (np.sqrt(np.mean((s - true)[inner] ** 2)) for s in (speed, raw))
    assert fitted < 0.75 * plain
    assert np.mean(speed[inner & (true == 0)] == 0.0) > (0.5 if rate > 5 else 0.2)


def test_the_heading_holds_at_rest() -> None:
    t = np.arange(0.0, 60.0)
    x = np.minimum(t, 30.0) * 2.0
    speed, heading = fitted_motion(t, x, np.zeros(60))
    assert (speed[35:] == 0.0).all() and (heading[35:] == 0.0).all()
    assert speed[5:28] == pytest.approx(np.full(23, 2.0))


@pytest.mark.parametrize("noise", [0.02, 0.2, 0.5, 1.5])
@pytest.mark.parametrize("rate", [0.1, 1.0, 5.0])
def test_noise_of_the_positions_is_no_motion(noise: float, rate: float) -> None:
    """Four drives with stops of five minutes between them, and no fifth, whatever the noise of the log."""
    t = np.arange(0.0, 1700.0, 1.0 / rate)
    driven = np.interp(t, [300, 340, 640, 680, 980, 1020, 1320, 1360], [0, 100, 100, 200, 200, 300, 300, 400])
    rng = np.random.default_rng(0)
    x, y = driven + rng.normal(0.0, noise, len(t)), rng.normal(0.0, noise, len(t))
    speed, _ = fitted_motion(t, x, y)
    truck = Trajectory("T", (t * 1e6).astype(np.int64), {"speed": speed})
    assert len(np.unique(trip_ids(truck))) == 4
    if rate >= 1.0 and noise <= 0.5:  # what is hidden longer than a line is not told
        assert np.sum(speed) / rate == pytest.approx(400.0, rel=0.05)


@pytest.mark.parametrize("drift", [0.3, 1.0, 1.5])
@pytest.mark.parametrize("rate", [0.2, 1.0, 5.0])
def test_a_receiver_that_drifts_does_not_drive(drift: float, rate: float) -> None:
    """Four drives with stops of five minutes; positions drift by metres within a minute, as outdoors."""
    t = np.arange(0.0, 1700.0, 1.0 / rate)
    driven = np.interp(t, [300, 340, 640, 680, 980, 1020, 1320, 1360], [0, 100, 100, 200, 200, 300, 300, 400])
    held = np.exp(-1.0 / (60.0 * rate))  # Ornstein and Uhlenbeck's process, 60 s
    chance = drift * np.sqrt(1.0 - held**2) * np.random.default_rng(0).normal(size=(2, len(t)))
    x, y = (lfilter([1.0], [1.0, -held], c) for c in chance)
    speed, _ = fitted_motion(t, driven + x, y)
    truck = Trajectory("T", (t * 1e6).astype(np.int64), {"speed": speed})
    assert len(np.unique(trip_ids(truck))) == 4
    assert np.sum(speed) / rate == pytest.approx(400.0, rel=0.05 if rate >= 1.0 else 0.15)


def test_no_line_across_a_gap() -> None:
    t = np.concatenate([np.arange(0.0, 10.0), np.arange(100.0, 110.0)])
    x = np.where(t < 50, 0.0, 1000.0)
    speed, _ = fitted_motion(t, x, x * 0)
    assert (speed == 0.0).all()


def test_what_the_log_says_stays() -> None:
    t = np.arange(0.0, 10.0)
    rows = Trajectory(
        "A", (t * 1e6).astype(np.int64), {"x": 2 * t, "y": t * 0, "speed": np.where(t < 5, 7.0, np.nan)}
    )
    speed = derive_motion(rows).floats("speed")
    assert speed[:5].tolist() == [7.0] * 5 and speed[5:] == pytest.approx([2.0] * 5)


def test_power_of_voltage_and_current() -> None:
    rows = Trajectory(
        "A", np.arange(3), {"battery_voltage": np.full(3, 48.0), "battery_current": np.array([10.0, np.nan, -5.0]),
                            "battery_power": np.array([np.nan, np.nan, 1.0])},
    )  # fmt: skip
    assert np.array_equal(derive_power(rows).floats("battery_power"), [480.0, np.nan, 1.0], equal_nan=True)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1.0, None), (3.6, "km/h"), (2.23694, "mph"), (1.94384, "kn"), (1.3, None)]
)
def test_a_speed_in_another_unit_is_noticed(factor: float, unit: str | None) -> None:
    t = np.arange(0.0, 900.0)
    v = 4.0 + 2.0 * np.sin(t / 20)
    x = np.concatenate([[0], np.cumsum(v[1:])]) + np.random.default_rng(1).normal(0, 0.5, 900)
    ratio = pace_ratio(Trajectory("A", (t * 1e6).astype(np.int64), {"x": x, "y": t * 0, "speed": v * factor}))
    assert ratio == pytest.approx(factor, rel=0.05)
    found = suspect_unit([ratio])
    assert (found[0] if found else None) == unit


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


@pytest.mark.parametrize(
    ("sector", "written", "seems"),
    [
        (3.0, lambda h: h, None),
        (3.0, lambda h: h + np.pi * (np.arange(len(h)) // 97 % 2), None),  # half of it backwards
        (3.0, lambda h: h + np.pi / 2, None),  # sideways
        (3.0, lambda h: h + 0.1, None),  # mounted askew
        (3.0, lambda h: np.pi / 2 - h, "clockwise from north"),
        (3.0, lambda h: np.pi / 2 - h + np.pi * (np.arange(len(h)) // 97 % 2), "clockwise from north"),
        (0.05, lambda h: np.degrees(h + 0.06), "in degrees"),
        (0.0, lambda h: np.full(len(h), 3.0), None),  # nothing tells three degrees from where it drives
        (0.05, lambda h: 90.0 - np.degrees(h + np.pi / 2 - 0.06), "in degrees, clockwise from north"),
    ],
)
def test_a_heading_in_another_unit_or_sense_is_noticed(
    sector: float, written: Any, seems: str | None
) -> None:
    t = np.arange(0.0, 900.0)
    rng = np.random.default_rng(4)
    turns = np.repeat(rng.uniform(-sector, sector, 45), 20)
    heading = written(turns)
    shift = {"in degrees": 0.06, "in degrees, clockwise from north": np.pi / 2 - 0.06}.get(seems or "", 0.0)
    way = turns + (shift if sector else 3.0)
    x, y = (np.cumsum(2.0 * f(way)) + rng.normal(0, 0.05, len(t)) for f in (np.cos, np.sin))
    columns = {"x": x, "y": y, "heading": _wrapped(heading + rng.normal(0, 0.01, len(t)))}
    assert other_reading(Trajectory("A", (t * 1e6).astype(np.int64), columns)) == seems
    short = Trajectory("A", (t[:20] * 1e6).astype(np.int64), {n: v[:20] for n, v in columns.items()})
    assert other_reading(short) is None


def test_positions_that_freeze_while_the_truck_moves_are_unknown_until_they_change() -> None:
    """Into a hall, where the receiver repeats its last fix, a stop there, and out by the same gate."""
    t = np.arange(0.0, 200.0)
    inside = (t > 60.0) & (t < 140.0)
    speed = np.where((t > 90.0) & (t < 110.0), 0.0, 2.0)
    x = np.where(inside, 120.0, np.where(t <= 60.0, 2.0 * t, 400.0 - 2.0 * t))
    rows = Trajectory("T", (t * 1e6).astype(np.int64), {"x": x, "y": 0.0 * t, "speed": speed})
    found = fill_positions(release_held(rows))
    assert np.isnan(found.floats("x")[62:139]).all()
    assert np.isfinite(found.floats("x")[(t <= 60.0) | (t > 140.0)]).all()
