"""Energy of reconstructed motion against the recorder's own, whatever the logger.

And what is stated of its error.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from recorded import Drives, Logger, drives, logged

from fleetlog.core.motion import Motion
from fleetlog.core.network import Edge, build_network
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.motion import Reconstruction, reconstruct
from fleetlog.physics.power import Physics, battery_power

WINDOW = 10.0
shift = cache(drives)


def power(drive: Drives):
    """Power of a motion of the true truck."""
    physics = Physics(drive.truck)
    return lambda motion: battery_power(motion, physics)


def windows(log: Trajectory, found: Reconstruction, drive: Drives) -> tuple[np.ndarray, ...]:
    """Recorded and modelled energy of every window [J], and the variance that is stated."""
    number = np.floor(log.seconds() / WINDOW).astype(int)
    recorded = np.bincount(number, log.floats("battery_power") * found.dt_row)
    of_sample = number[found.row]
    model = np.bincount(of_sample, power(drive)(found.motion) * found.motion.dt, len(recorded))
    return recorded, model, found.window_variance(power(drive), of_sample)


# logger, most error of the total, most of the standard deviation of the z-scores
LOGGERS = {
    "20 Hz": (Logger((0.05,)), 0.01, 1.3),
    "10 Hz": (Logger((0.1,)), 0.01, 1.3),
    "10 Hz, noisy speed": (Logger((0.1,), speed=0.1), 0.015, 1.3),
    "10 Hz, no speed": (Logger((0.1,), speed=None, position=0.3), 0.03, 1.8),
    "5 Hz": (Logger((0.2,)), 0.01, 1.3),
    "2 Hz": (Logger((0.5,)), 0.01, 1.3),
    "1 Hz": (Logger(), 0.01, 1.3),
    "1 Hz, exact speed": (Logger(speed=0.0), 0.015, 1.3),
    "1 Hz, noisy speed": (Logger(speed=0.1), 0.015, 1.4),
    "1 Hz, no speed": (Logger(speed=None), 0.02, 1.7),
    "1 Hz, stamps jitter": (Logger(jitter=0.3), 0.015, 1.3),
    "1 Hz, positions repeated": (Logger(repeat=5), 0.015, 1.3),
    "1 Hz, speed the mean since the last row": (Logger(mean=True), 0.015, 1.3),
    "0.5 Hz": (Logger((2.0,)), 0.02, 1.4),
    "0.2 Hz": (Logger((5.0,)), 0.05, 1.7),
    "3, 5, 7 s": (Logger((3.0, 5.0, 7.0)), 0.04, 1.8),
}


@pytest.mark.parametrize("name", LOGGERS)
def test_the_energy_is_the_recorded_one_within_what_is_stated(name: str) -> None:
    logger, most, spread = LOGGERS[name]
    totals, scores = [], []
    for seed in (1, 2, 3):
        drive = shift(seed, 0.7)
        log = logged(drive, logger, seed)
        recorded, model, variance = windows(log, reconstruct(log, drive.network, drive.truck), drive)
        totals.append(model.sum() / recorded.sum() - 1.0)
        driven = variance > 100.0**2
        scores.append(((model - recorded) / np.sqrt(variance + 30.0**2))[driven])
    assert np.abs(totals).max() < most, totals
    z = np.concatenate(scores)
    assert 0.45 < z.std() < spread, z.std()
    assert abs(np.median(z)) < 0.5


def test_a_denser_log_has_the_same_energy_within_what_is_stated() -> None:
    drive = shift(4, 0.7)
    watts = power(drive)
    totals, doubts = [], []
    for step in (0.1, 1.0):
        found = reconstruct(logged(drive, Logger((step,)), 4), drive.network, drive.truck)
        totals.append(watts(found.motion) @ found.motion.dt)
        hidden = totals[-1] - watts(found.likeliest) @ found.motion.dt
        doubts += [found.window_variance(watts, np.zeros(len(found.row), np.int64))[0], hidden**2]
    assert abs(totals[0] - totals[1]) < 3.0 * np.sqrt(sum(doubts))
    assert totals[1] == pytest.approx(totals[0], rel=0.015)


def moved(drive: Drives, log: Trajectory, angle: float, mirror: float) -> tuple[Trajectory, object]:
    """Site and log turned, mirrored and shifted."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ np.diag(
        [1.0, mirror]
    )

    def placed(points: np.ndarray) -> np.ndarray:
        return np.column_stack([points[:, :2] @ turn.T + [400.0, -70.0], points[:, 2:]])

    n = drive.network
    edges = [
        Edge(n.edge_ids[i], n.node_ids[n.start[i]], n.node_ids[n.end[i]], placed(n.polyline(i)), n.roads[i])
        for i in range(len(n))
    ]
    x, y = placed(np.column_stack([log.floats("x"), log.floats("y")])).T
    return log.with_columns(x=x, y=y), build_network(edges)


@pytest.mark.parametrize(("angle", "mirror"), [(0.7, 1.0), (2.6, -1.0)])
@pytest.mark.parametrize("on_map", [True, False])
def test_turning_mirroring_and_shifting_the_site_changes_no_energy(
    angle: float, mirror: float, on_map: bool
) -> None:
    drive = shift(5, 0.4)
    log = logged(drive, Logger((1.0,)), 5, matched=on_map)
    there, network = moved(drive, log, angle, mirror)
    a = reconstruct(log, drive.network if on_map else None, drive.truck)
    b = reconstruct(there, network if on_map else None, drive.truck)
    watts = power(drive)
    assert watts(b.motion) @ b.motion.dt == pytest.approx(watts(a.motion) @ a.motion.dt, rel=1e-4)
    assert np.allclose(b.motion.curvature, mirror * a.motion.curvature, atol=1e-3)


@pytest.mark.parametrize(("on_map", "most"), [(True, 0.03), (False, 0.25)])
def test_the_angle_turned_is_the_true_one(on_map: bool, most: float) -> None:
    """What a cornering coefficient is multiplied with: the same whatever asks for it."""
    drive = shift(6, 0.7)
    log = logged(drive, Logger(), 6, matched=on_map)
    found = reconstruct(log, drive.network if on_map else None, drive.truck).motion
    turned = (np.abs(found.curvature) * found.speed) @ found.dt
    true = (np.abs(drive.truth["bend"]) * drive.truth["v"]).sum() / 20.0
    assert turned == pytest.approx(true, rel=most)


def test_rows_share_the_time_of_the_log() -> None:
    drive = shift(7, 0.3)
    log = logged(drive, Logger((3.0, 5.0, 7.0), jitter=0.3), 7)
    found = reconstruct(log, drive.network)
    assert found.dt_row.sum() == pytest.approx(log.seconds()[-1])
    assert found.rows(found.motion.dt) == pytest.approx(found.dt_row)
    silent = log[(log.seconds() < 300.0) | (log.seconds() > 500.0)]
    gap = np.diff(silent.seconds()).max()
    found = reconstruct(silent, drive.network)
    assert found.dt_row.sum() == pytest.approx(log.seconds()[-1] - gap)
    assert found.motion.dt.max() <= 7.0 and found.motion.dt[~found.standing].max() <= 0.25 + 1e-9


def test_samples_lie_about_what_is_likeliest() -> None:
    drive = shift(1, 0.7)
    found = reconstruct(logged(drive, Logger(), 1), drive.network)
    work = (found.motion.acceleration * found.motion.dt)[~found.standing].sum()
    likeliest = found.likeliest.acceleration @ found.motion.dt
    assert work == pytest.approx(likeliest, abs=0.02 * np.abs(likeliest) + 1.0)


def test_power_that_runs_late_meets_the_motion_of_its_moment() -> None:
    drive = shift(2, 0.7)
    log = logged(drive, Logger(), 2)
    late = 2.0
    seconds = log.seconds()
    behind = log.with_columns(battery_power=np.interp(seconds - late, seconds, log.floats("battery_power")))
    known = power(drive)

    def misfit(lag: float) -> float:
        found = reconstruct(behind, drive.network, drive.truck, lag)
        model = found.rows(known(found.motion) * found.motion.dt) / np.maximum(found.dt_row, 1e-9)
        driven = found.rows(found.motion.speed) > 0.0
        return float(np.std((model - behind.floats("battery_power"))[driven]))

    assert misfit(late) < 0.6 * min(misfit(0.0), misfit(1.0), misfit(3.0))


def test_a_lift_between_two_windows_may_be_part_of_either() -> None:
    """Rows 10 s apart, one short lift: how much of it each window has is stated as unknown."""
    drive = shift(1, 0.7)
    seconds = np.arange(0.0, 60.0, 5.0)
    height = np.where(seconds < 28.0, 0.0, 0.3)
    log = Trajectory("T", (seconds * 1e6).astype(np.int64), {
        "x": np.zeros(12), "y": np.zeros(12), "speed": np.zeros(12), "fork_height": height,
    })  # fmt: skip
    log = log.with_columns(fork_height=height + np.where(seconds > 50.0, 1.75, 0.0))
    found = reconstruct(log)
    number = (found.row >= 6).astype(np.int64)
    lifted = power(drive)(found.motion.replaced(lift_speed=np.zeros(len(found.motion))))
    share = np.bincount(number, (power(drive)(found.motion) - lifted) * found.motion.dt)
    variance = found.window_variance(power(drive), number)
    first_lift = share.sum() * 0.3 / (0.3 + 1.75)
    assert variance[0] == pytest.approx(variance[1])
    assert 0.2 * first_lift < np.sqrt(variance[0]) < 0.5 * first_lift


def test_a_motion_of_no_rows() -> None:
    assert len(reconstruct(Trajectory("T", np.zeros(0, np.int64))).motion) == 0
    assert isinstance(reconstruct(Trajectory("T", np.zeros(0, np.int64))).motion, Motion)
