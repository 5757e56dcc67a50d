"""Cleaning: one outlier takes nothing else with it, restarts are kept, stuck and repeated values are noticed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.trajectory import Labels, Trajectory, concatenate
from fleetlog.ingest import clean
from fleetlog.ingest.derive import fill_positions, interpolated, join_channels, release_held
from fleetlog.ingest.reading import Order, run_starts
from fleetlog.ingest.rows import CHANNEL, FILE, HELD, RECORD, Rejects

SECOND = 1_000_000


def track(t: Any, **columns: Any) -> Trajectory:
    time = np.rint(np.asarray(t, float) * SECOND).astype(np.int64)
    where = {FILE: np.zeros(len(time)), RECORD: np.arange(1.0, len(time) + 1)}
    return Trajectory("A", time, {**columns, **where})


def straight(n: int = 100, v: float = 2.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.arange(float(n))
    return t, v * t, np.zeros(n)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 99), st.floats(500, 1e6)), max_size=12), st.integers(0, 2**31))
def test_outliers_go_and_nothing_else(outliers: list[tuple[int, float]], seed: int) -> None:
    t, x, y = straight()
    at = sorted({i for i, _ in outliers})
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(at))
    for i, a in zip(at, angle, strict=True):
        x[i] += 1e4 * np.cos(a)
        y[i] += 1e4 * np.sin(a)
    assert np.flatnonzero(clean.jump_outliers(x, y, t)).tolist() == at


def test_a_log_that_resumes_elsewhere_is_kept() -> None:
    t, x, y = straight()
    x[50:] += 5e4
    assert not clean.jump_outliers(x, y, t).any()


def test_fast_but_possible_is_no_jump() -> None:
    t, x, y = straight(50, 55.0)
    assert not clean.jump_outliers(x, y, t).any()
    assert not clean.jump_outliers(x * 0 + np.arange(50) * 1000, y, t * 60).any()


def test_bounds_take_the_value_and_leave_the_row() -> None:
    t, x, y = straight(5)
    rows = track(
        t,
        x=x,
        y=y,
        soc=np.array([0.5, 1.5, -0.1, 1.0 + 1e-9, np.nan]),
        speed=np.array([0.0, -3.6, 61.0, 2.0, 2.0]),
    )
    rejects = Rejects(None, ["a"])
    out = clean.bound_values(rows, rejects)
    assert len(out) == 5
    assert np.array_equal(out.floats("soc"), [0.5, np.nan, np.nan, 1.0, np.nan], equal_nan=True)
    assert np.isnan(out.floats("speed")).tolist() == [False, True, True, False, False]
    assert sum(rejects.values.values()) == 4 and not rejects.rows


def test_no_fix_is_unknown() -> None:
    rows = track([0, 1, 2], latitude=np.array([0.0, 49.0, 49.0]), longitude=np.array([0.0, 9.0, np.nan]))
    out = clean.drop_impossible(rows, Rejects(None, ["a"]))
    assert (
        np.isnan(out.floats("latitude")).tolist()
        == [True, False, True]
        == np.isnan(out.floats("longitude")).tolist()
    )


def test_duplicates_are_told_from_contradictions() -> None:
    rows = track(
        [0, 0, 1, 1],
        x=np.array([1.0, 1.0, 2.0, 3.0]),
        y=np.full(4, np.nan),
        mode=Labels.of(["a", "a", None, None]),
    )
    rejects = Rejects(None, ["a"])
    out = clean.drop_duplicates(rows, rejects)
    assert out.floats("x").tolist() == [1.0, 2.0]
    assert sorted(rejects.rows.values()) == [1, 1] and len(rejects.rows) == 2


def test_a_stuck_speed_is_unknown_only_when_the_truck_stands() -> None:
    t, x, y = straight(120)
    driving = track(t, x=x, y=y, speed=np.full(120, 2.0))
    assert not np.isnan(clean.unstick(driving).floats("speed")).any()
    standing = track(t, x=x * 0 + 7.0, y=y, speed=np.full(120, 2.0))
    assert np.isnan(clean.unstick(standing).floats("speed")).all()
    parked = track(t, x=x * 0, y=y, speed=np.zeros(120))
    assert not np.isnan(clean.unstick(parked).floats("speed")).any()


def test_a_stuck_power_is_unknown_only_when_the_truck_stops_and_drives() -> None:
    t, x, y = straight(300)
    speed = np.where(t % 60 < 30, 2.0, 0.0)
    power = np.full(300, 1234.5)
    assert np.isnan(
        clean.unstick(track(t, x=x, y=y, speed=speed, battery_power=power)).floats("battery_power")
    ).all()
    for alive in (power + t, np.where(t % 100 < 1, 1.0, power), np.zeros(300)):
        assert not np.isnan(
            clean.unstick(track(t, x=x, y=y, speed=speed, battery_power=alive)).floats("battery_power")
        ).any()
    steady = track(t, x=x, y=y, speed=speed * 0 + 2.0, battery_power=power)
    assert not np.isnan(clean.unstick(steady).floats("battery_power")).any()


@pytest.mark.parametrize("every", [5, 12, 30])
def test_repeated_fixes_are_placed_by_the_distance_driven(every: int) -> None:
    t = np.arange(0.0, 300.0)
    speed = 5.0 + 4.0 * np.sin(t / 7.0)
    x = np.concatenate([[0.0], np.cumsum(speed[1:])])
    held = x[np.arange(300) // every * every]
    out = fill_positions(release_held(track(t, x=held, y=held * 0, z=held * 0.01, speed=speed)))
    last = 300 // every * every - every + 1
    assert np.abs(out.floats("x")[:last] - x[:last]).max() < 1e-6
    assert np.abs(out.floats("z")[:last] - 0.01 * x[:last]).max() < 1e-6
    assert out.floats(HELD).sum() >= 300 * (1 - 1 / every) - 5


def test_standing_still_is_not_a_repeated_fix() -> None:
    t = np.arange(0.0, 200.0)
    speed = np.where(t < 100, 0.0, 2.0)
    x = np.concatenate([[0.0], np.cumsum(speed[1:])])
    assert HELD not in release_held(track(t, x=x, y=x * 0, speed=speed))


def test_long_gaps_stay_unknown() -> None:
    x = np.full(100, np.nan)
    x[[0, 99]] = [0.0, 99.0]
    rows = track(np.arange(100.0), x=x, y=x * 0, speed=np.full(100, 1.0))
    assert np.isnan(fill_positions(rows).floats("x")[1:99]).all()
    blind = track(
        np.arange(0, 4.0), x=np.array([0, np.nan, np.nan, 3.0]), y=np.array([0, np.nan, np.nan, 0.0])
    )
    assert fill_positions(blind).floats("x").tolist() == [0.0, 1.0, 2.0, 3.0]


def sifted(seconds: list[float], size: int) -> tuple[list[int], list[int]]:
    order, kept, gone = Order(), [], []
    rows = track(seconds)
    for i in range(0, len(seconds), size):
        good, bad = order.sift(rows[i : i + size])
        kept += good.time.tolist()
        gone += bad.time.tolist()
    for good, bad in order.flush():
        kept += good.time.tolist()
        gone += bad.time.tolist()
    return [k // SECOND for k in kept], [g // SECOND for g in gone]


@pytest.mark.parametrize("size", [1, 3, 7, 1000])
def test_time_running_backwards(size: int) -> None:
    base = [float(i) for i in range(50)]
    kept, gone = sifted([*base, 10.0 - 3600, *[50.0 + i for i in range(50)]], size)
    assert gone == [-3590] and len(kept) == 100
    kept, gone = sifted([*base, 1e6, *[50.0 + i for i in range(50)]], size)  # a clock that leaps once
    assert gone == [1_000_000] and len(kept) == 100
    kept, gone = sifted([*base, 20.0, *[50.0 + i for i in range(50)]], size)  # late by less than the window
    assert not gone and len(kept) == 101
    kept, gone = sifted([*[i + 9e4 for i in base], *base], size)  # two days put together the wrong way round
    assert not gone and len(kept) == 100
    kept, gone = sifted([*base, 9000.0, 9001.0], size)  # switched on again for two rows
    assert not gone and len(kept) == 52


@given(st.lists(st.floats(-59, 0), min_size=1, max_size=60))
def test_rows_late_by_less_than_the_window_are_one_run(late: list[float]) -> None:
    t = np.arange(len(late)) + np.array(late)
    t[0] = 0.0
    assert len(run_starts((t * SECOND).astype(np.int64))) == 1


def test_channels_reach_the_rows_between() -> None:
    t = np.arange(0.0, 100.0)
    base = track(t, x=t, y=t, battery_power=np.full(100, np.nan))
    given = np.arange(0.5, 60.0, 5.0)
    channel = track(given, battery_power=100.0 + given, mode=Labels.of([f"m{int(g)}" for g in given]))
    channel = channel.with_columns(**{CHANNEL: np.ones(len(given))})
    out = join_channels(clean.sort_rows(concatenate([base, channel])))
    assert len(out) == 100 and CHANNEL not in out
    power = out.floats("battery_power")
    assert power[1:56] == pytest.approx(100.0 + t[1:56])
    assert np.isnan(power[80:]).all()
    assert out.labels("mode").strings()[:7] == [None, "m0", "m0", "m0", "m0", "m0", "m5"]


def test_a_channel_does_not_bridge_its_own_gaps() -> None:
    t = np.array([0.0, 1.0, 2.0, 50.0, 51.0])
    out = interpolated(np.array([0.5, 25.0, 50.5]), t, t)
    assert np.isnan(out).tolist() == [False, True, False]
