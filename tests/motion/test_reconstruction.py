"""The smoother against truth, and its laws."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from truth import Truth, long_road, on_road, shuttle

from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.errors import DataError
from fleetlog.physics.motion import Noise, Reconstruction, reconstruct
from fleetlog.physics.motion.reconstruction import SQUARE, _spread
from fleetlog.roads.matching import match

ROAD = long_road()


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def errors(found: Reconstruction, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Of speed and of the likeliest acceleration at the samples."""
    v, a = (np.interp(found.motion.time, truth.t, values) for values in (truth.speed, truth.acceleration))
    return found.motion.speed - v, likeliest(found) - a


def likeliest(found: Reconstruction) -> np.ndarray:
    """(n,) acceleration without the spread about it."""
    return np.where(found.standing, 0.0, found.states.mean[found.node, 2])


# noise [m], rate [1/s], most speed error [m/s], most acceleration error [m/s2]
LEVELS = [
    (0.02, 10.0, 0.05, 0.20),
    (0.1, 10.0, 0.08, 0.20),
    (0.5, 10.0, 0.15, 0.25),
    (2.0, 10.0, 0.35, 0.35),
    (0.02, 1.0, 0.10, 0.20),
    (0.5, 1.0, 0.25, 0.25),
    (2.0, 1.0, 0.55, 0.35),
]


@pytest.mark.parametrize(("noise", "rate", "speed", "acceleration"), LEVELS)
def test_speed_and_acceleration_from_positions(
    noise: float, rate: float, speed: float, acceleration: float
) -> None:
    truth = shuttle(900.0, rate, 1)
    v, a = errors(reconstruct(on_road(truth, ROAD, noise, 2), ROAD), truth)
    assert rms(v) < speed
    assert rms(a) < acceleration
    # far better than differences of positions
    if noise >= 0.5:
        x = on_road(truth, ROAD, noise, 2).floats("x")
        assert rms(v) < 0.4 * rms(np.gradient(x, truth.t) - truth.speed)


@pytest.mark.parametrize(("noise", "rate"), [(0.1, 10.0), (1.0, 10.0), (0.5, 1.0)])
def test_after_the_matcher_it_is_as_good(noise: float, rate: float) -> None:
    """Edges, places and standstills found from the noisy positions, not told."""
    truth = shuttle(900.0, rate, 23)
    log = on_road(truth, ROAD, noise, 24)
    found = match(log, ROAD)
    log = log.with_columns(edge_id=Labels(found.edge, ROAD.edge_ids), edge_offset=found.offset)
    motion = reconstruct(log, ROAD)
    v, a = errors(motion, truth)
    assert rms(v) < 0.3
    assert rms(a) < 0.3
    assert motion.motion.speed[np.interp(motion.motion.time, truth.t, truth.speed) == 0.0].mean() < 0.05


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_the_log_speed_is_used(rate: float) -> None:
    truth = shuttle(900.0, rate, 3)
    without = errors(reconstruct(on_road(truth, ROAD, 1.0, 4), ROAD), truth)[0]
    with_speed = errors(reconstruct(on_road(truth, ROAD, 1.0, 4, speed_noise=0.05), ROAD), truth)[0]
    assert rms(with_speed) < 0.06
    assert rms(with_speed) < 0.6 * rms(without)


@pytest.mark.parametrize(("noise", "rate"), [(0.1, 10.0), (1.0, 10.0), (0.5, 1.0)])
def test_the_stated_uncertainty_covers_the_error(noise: float, rate: float) -> None:
    truth = shuttle(1200.0, rate, 5)
    found = reconstruct(on_road(truth, ROAD, noise, 6), ROAD)
    moving = np.interp(found.motion.time, truth.t, truth.speed) > 0.3
    error = errors(found, truth)[0][moving]
    share = np.mean(np.abs(error) < 2.0 * found.speed_sd[moving])
    assert 0.80 < share <= 1.0
    assert np.median(found.speed_sd[moving]) < 3.0 * rms(error)


def test_the_noise_is_measured() -> None:
    """Of the positions: that of their mean over a second."""
    truth = shuttle(900.0, 10.0, 7)
    for noise in (0.1, 0.5, 2.0):
        found = reconstruct(on_road(truth, ROAD, noise, 8), ROAD).noise
        assert found.position == pytest.approx(noise / np.sqrt(10.0), rel=0.3)


def test_off_the_map_in_the_plane() -> None:
    """Round a circle of 8 m at 2 m/s: speed, heading and curvature without any map."""
    t = np.arange(0, 120, 0.2)
    rng = np.random.default_rng(1)
    angle = 2.0 * t / 8.0
    x, y = 8 * np.cos(angle) + rng.normal(0, 0.05, len(t)), 8 * np.sin(angle) + rng.normal(0, 0.05, len(t))
    motion = reconstruct(Trajectory("T", (t * 1e6).astype(np.int64), {"x": x, "y": y})).motion
    angle = np.interp(motion.time, t, angle)
    middle = slice(25, -25)
    assert np.abs(motion.speed[middle] - 2.0).max() < 0.15
    assert motion.curvature[middle].mean() == pytest.approx(1 / 8, rel=0.05)
    assert np.cos(motion.heading - angle - np.pi / 2)[middle].min() > 0.98


@settings(max_examples=20, deadline=None)
@given(st.floats(0.2, 8.0), st.sampled_from([0.5, 1.0, 5.0, 10.0]))
def test_constant_speed_stays_constant(speed: float, rate: float) -> None:
    t = np.arange(0, 100 / rate, 1 / rate)
    truth = Truth(t, speed * t, np.full(len(t), speed), np.zeros(len(t)))
    found = reconstruct(on_road(truth, ROAD, 0.0, 0), ROAD, noise=Noise(0.05, 0.1, 0.1))
    assert np.allclose(found.motion.speed, speed, atol=2e-3)
    assert np.allclose(likeliest(found), 0.0, atol=2e-3)


def test_time_run_backwards_gives_the_speed_backwards() -> None:
    """The same positions in the opposite order: the same speeds, the accelerations with the other sign."""
    truth = shuttle(800.0, 1.0, 11)
    noise = Noise(0.1, 0.3, 0.1)
    there = on_road(truth, ROAD, 0.3, 12)
    end = int(there.time[-1])
    x, y, index = there.floats("x")[::-1], there.floats("y")[::-1], there.labels("edge_id").codes[::-1]
    back = there.with_columns(
        x=x.copy(), y=y.copy(), edge_offset=(ROAD.length[index] - there.floats("edge_offset")[::-1]),
        edge_id=type(there.labels("edge_id"))(ROAD.reverse[index], ROAD.edge_ids),
    )  # fmt: skip
    back = Trajectory("T", end - there.time[::-1], back.columns)
    a, b = (reconstruct(log, ROAD, noise=noise) for log in (there, back))
    inside = slice(30, -30)  # the filter is told something of the start, nothing of the end
    # an acceleration dies away after it began, not before it
    assert rms((a.motion.speed - b.motion.speed[::-1])[inside]) < 0.05
    assert rms((likeliest(a) + likeliest(b)[::-1])[inside]) < 0.08


@settings(max_examples=10, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-1000, 1000), st.integers(0, 100))
def test_moving_and_turning_the_frame_changes_nothing(angle: float, shift: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = shuttle(100.0, 2.0, seed)
    x, y = (
        truth.way + rng.normal(0, 0.2, len(truth.t)),
        5 * np.sin(truth.way / 10) + rng.normal(0, 0.2, len(truth.t)),
    )
    c, s = np.cos(angle), np.sin(angle)
    time = np.round(truth.t * 1e6).astype(np.int64)
    noise = Noise(0.1, 0.2, 0.1)
    here, there = (
        reconstruct(Trajectory("T", time, {"x": x, "y": y}), noise=noise).motion
        for x, y in ((x, y), (c * x - s * y + shift, s * x + c * y))
    )
    assert np.allclose(here.speed, there.speed, atol=1e-5)
    assert np.allclose(here.acceleration, there.acceleration, atol=1e-5)
    assert np.allclose(here.curvature, there.curvature, atol=1e-5)


def test_a_standstill_has_speed_zero_exactly() -> None:
    truth = shuttle(600.0, 10.0, 13)
    for speed_noise in (None, 0.05):
        found = reconstruct(on_road(truth, ROAD, 0.3, 14, speed_noise), ROAD)
        motion = found.motion
        standing = truth.speed == 0.0
        inner = standing & np.roll(standing, 17) & np.roll(standing, -17)
        assert (motion.speed[inner] == 0.0).all() and (motion.acceleration[inner] == 0.0).all()
        assert found.standing[inner].all()


def test_irregular_rows_and_a_gap() -> None:
    rng = np.random.default_rng(15)
    truth = shuttle(600.0, 10.0, 16)
    keep = np.sort(rng.choice(len(truth.t), 1200, replace=False))
    keep = keep[(keep < 2000) | (keep > 3000)]  # a hundred seconds of silence
    log = on_road(truth, ROAD, 0.1, 17)[keep]
    found = reconstruct(log, ROAD)
    motion = found.motion
    at = int(np.argmax(np.diff(keep)))
    assert rms(errors(found, truth)[0]) < 0.2
    assert found.rows(motion.dt) == pytest.approx(found.dt_row)
    span = truth.t[keep][-1] - truth.t[keep][0] - (truth.t[keep][at + 1] - truth.t[keep][at])
    assert motion.dt.sum() == pytest.approx(span)
    assert (motion.dt >= 0.0).all()


def test_neither_position_nor_speed_is_an_error() -> None:
    with pytest.raises(DataError, match="neither positions nor speeds"):
        reconstruct(Trajectory("T", np.arange(5) * 1_000_000, {"soc": np.ones(5)}))


def test_speed_alone_is_enough() -> None:
    truth = shuttle(300.0, 1.0, 20)
    found = reconstruct(Trajectory("T", (truth.t * 1e6).astype(np.int64), {"speed": truth.speed}))
    assert rms(errors(found, truth)[0]) < 0.1


@pytest.mark.parametrize("rows", [0, 1, 2, 3])
def test_the_shortest_logs(rows: int) -> None:
    truth = shuttle(30.0, 1.0, 21)
    found = reconstruct(on_road(truth, ROAD, 0.1, 22)[:rows], ROAD)
    assert len(found.dt_row) == rows and set(found.row) == set(range(rows))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-1e5, 1e5), st.one_of(st.floats(0, 20), st.just(float("nan"))), st.integers(1, 10**8)),
        min_size=1, max_size=40,
    ),
    st.booleans(),
)  # fmt: skip
def test_whatever_comes_the_motion_is_finite(rows: list[tuple[float, float, int]], speed: bool) -> None:
    x, v, step = (np.array(c, dtype=float) for c in zip(*rows, strict=True))
    columns = {"x": x, "y": 0.3 * x, **({"speed": v} if speed else {})}
    found = reconstruct(Trajectory("T", np.cumsum(step).astype(np.int64), columns))
    for name in ("speed", "acceleration", "slope", "curvature", "heading", "dt", "lift_speed", "payload"):
        assert np.isfinite(getattr(found.motion, name)).all(), name
    assert np.isfinite(found.speed_sd).all() and (found.motion.speed >= 0).all()


@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=40))
def test_samples_lie_about_the_likeliest_acceleration_as_is_said(errors: list[float]) -> None:
    """Their mean and mean size are those of a normal, their mean square a share of its, over rows of four."""
    deviation = np.repeat([[1.0, 0.6, 0.6, 1.0]], 2 * len(errors), axis=0) * np.repeat(errors, 2)[:, None]
    found = _spread(deviation.ravel()).reshape(deviation.shape)
    assert found.sum(axis=1) == pytest.approx(np.zeros(len(found)), abs=1e-12)
    assert np.abs(found).sum() == pytest.approx(np.sqrt(2.0 / np.pi) * deviation.sum())
    assert (found**2).sum() == pytest.approx(SQUARE * (deviation**2).sum())
