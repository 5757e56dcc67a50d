"""The recorded mission as finely stepped motion, block by block, for the nominal model to run over.

The switch between traction and regeneration is convex: evaluated on one-second samples it is wrong by several per cent,
which looks like missing physics.  So speed becomes a cubic spline and the model sees ``steps`` samples per row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.bends import path_curvature
from fleetlog.discovery.smooth import Akima

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STILL = 0.06
"""Below this a truck stands: the noise of a speed sensor at rest [m/s]."""
FINEST = 0.25
"""Length of a sub-step that resolves a braking truck [s]."""
MAX_STEPS = 20
KINK = 0.3
"""Change of acceleration from row to row that may hide a kink [m/s2]."""
MIN_ROWS = 8
"""A shorter uninterrupted piece of log says nothing [rows]."""
JOINED = 3.5
"""Rows further apart than this many sampling steps are not joined."""


@dataclass(frozen=True)
class Block:
    """Uninterrupted rows of one vehicle on one day.

    Attributes
    ----------
    motion : (rows * steps,) sub-samples; ``dt`` is the sub-step.
    steps : sub-samples per row.
    time, power, soc : (rows,) the recorded channels [s since the epoch, W, 1].
    vehicle, day : codes.
    trip : (rows,) codes, unique over vehicles.
    kinked : (rows * steps,) twice, speed and acceleration if both were free to change abruptly between two rows: what
        sampling may hide lies between these and the smooth ones.
    """

    motion: Motion
    steps: int
    time: Floats
    power: Floats
    soc: Floats
    trip: Ints
    vehicle: int
    day: int
    kinked: tuple[Floats, Floats]

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, values: Floats) -> Floats:
        """(rows, ...) mean over the sub-samples of each row."""
        shape = (len(self), self.steps, *values.shape[1:])
        return np.asarray(values.reshape(shape).mean(axis=1))


def blocks(
    trajectory: Trajectory,
    vehicle: int,
    network: Network | None,
    turn_radius: float,
    *,
    lag: float = 0.0,
    scale: float = 1.0,
    load_with_power: bool = False,
) -> Iterator[Block]:
    """The blocks of one vehicle-day.

    ``lag`` [s] is how far the power channel runs behind the positions (``load_with_power``: payload and fork height run
    with it), ``scale`` what the speed channel reads over the truth; both are put right here, by moving the smooth motion,
    never by interpolating noisy power.
    """
    time = trajectory.time * 1e-6
    speed = trajectory.floats("speed")
    good = np.isfinite(speed)
    if good.sum() < MIN_ROWS:
        return
    trajectory, time = trajectory[good], time[good]
    step = float(np.median(np.diff(time)))
    cuts = np.flatnonzero(np.diff(time) > JOINED * step) + 1
    for begin, end in zip([0, *cuts], [*cuts, len(time)], strict=True):
        if end - begin >= MIN_ROWS:
            piece = trajectory[int(begin) : int(end)]
            yield _block(piece, vehicle, network, turn_radius, step, lag, scale, load_with_power)


def _block(
    piece: Trajectory,
    vehicle: int,
    network: Network | None,
    turn_radius: float,
    step: float,
    lag: float,
    scale: float,
    load_with_power: bool,
) -> Block:
    time = np.asarray(piece.time * 1e-6, dtype=np.float64)
    steps = int(np.clip(np.ceil(step / FINEST), 4, MAX_STEPS))
    width = np.minimum(np.gradient(time), 1.5 * step)
    inside = (np.arange(steps) + 0.5) / steps - 0.5
    fine = (time[:, None] - lag + width[:, None] * inside).ravel()
    speed, acceleration = _smooth_speed(time, piece.floats("speed") / scale, fine)
    row = np.clip(np.rint(np.interp(fine, time, np.arange(len(time)))).astype(int), 0, len(time) - 1)
    edge, offset = _places(piece, network, row, fine - time[row], speed)
    own = np.repeat(np.arange(len(time)), steps)
    load, load_time = (own, fine + lag) if load_with_power else (row, fine)
    height = piece.floats("fork_height")
    payload = np.nan_to_num(piece.floats("payload"))
    heading = np.interp(fine, time, np.unwrap(np.nan_to_num(piece.floats("heading"))))
    motion = Motion(
        time=fine, dt=np.repeat(width / steps, steps), speed=speed, acceleration=acceleration,
        slope=_slope(piece, network, edge, offset, row), heading=heading,
        curvature=path_curvature(piece, network, edge, offset, row, turn_radius, speed),
        payload=payload[load], lift_speed=_lift_speed(time, height, load_time),
        fork_height=np.nan_to_num(height)[load], x=np.interp(fine, time, piece.floats("x")),
        y=np.interp(fine, time, piece.floats("y")), edge=edge, edge_offset=offset,
        ambient_temperature=piece.floats("ambient_temperature")[own], soc=piece.floats("soc")[own],
        vehicle=np.broadcast_to(np.int64(vehicle), len(fine)), trip=piece.trip_ids()[row], power=piece.floats("battery_power")[own],
    )  # fmt: skip
    day = int(piece.time[0] // 86_400_000_000)
    trip = piece.trip_ids() + 1_000_000 * vehicle
    kinked = _kinked_speed(time, piece.floats("speed") / scale, fine, speed, acceleration)
    return Block(
        motion, steps, time, piece.floats("battery_power"), piece.floats("soc"), trip, vehicle, day, kinked
    )


def _smooth_speed(time: Floats, speed: Floats, fine: Floats) -> tuple[Floats, Floats]:
    """Speed and acceleration of the spline of speed; at rest both are zero."""
    inside = np.clip(fine, time[0], time[-1])
    v, a = Akima(time, speed).with_slope(inside)
    # A spline overshoots below zero next to a standstill.
    still = (v < STILL) | (np.interp(inside, time, speed) < STILL)
    return np.where(still, 0.0, v), np.where(still, 0.0, a)


def _kinked_speed(
    time: Floats, speed: Floats, fine: Floats, smooth: Floats, acceleration: Floats
) -> tuple[Floats, Floats]:
    """Speed and acceleration where a row's interval in which acceleration changes much is two straight lines.

    The lines through the intervals before and after it meet inside it (subcell resolution: Harten 1989, doi
    10.1016/0021-9991(89)90226-X); elsewhere the smooth ones.
    """
    wide = np.diff(time)
    slope = np.diff(speed) / wide
    before, after = np.append(slope[:1], slope[:-1]), np.append(slope[1:], slope[-1:])
    jump = before - after
    meet = (speed[1:] - after * wide - speed[:-1]) / np.where(np.abs(jump) > KINK, jump, np.inf)
    kink = (np.abs(jump) > KINK) & (meet > 0.0) & (meet < wide) & (wide < 1.6 * np.median(wide))
    straight = np.zeros(len(kink), bool)
    straight[1:] |= kink[:-1]
    straight[:-1] |= kink[1:]
    i = np.clip(np.searchsorted(time, fine, side="right") - 1, 0, len(wide) - 1)
    x, sub = fine - time[i], float(np.median(np.diff(fine)))
    share = np.clip((meet[i] - (x - 0.5 * sub)) / sub, 0.0, 1.0)
    bent = np.where(x < meet[i], speed[i] + before[i] * x, speed[i + 1] + after[i] * (x - wide[i]))
    v = np.where(kink[i], bent, np.where(straight[i], speed[i] + slope[i] * x, smooth))
    a = np.where(
        kink[i],
        share * before[i] + (1.0 - share) * after[i],
        np.where(straight[i], slope[i], acceleration),
    )
    still = (smooth <= 0.0) | (v < STILL)
    return np.where(still, 0.0, v), np.where(still, 0.0, a)


def _lift_speed(time: Floats, height: Floats, fine: Floats) -> Floats:
    if not np.isfinite(height).any():
        return np.zeros(len(fine))
    rate = np.gradient(np.nan_to_num(height), time)
    return np.interp(fine, time, np.where(np.abs(rate) < 0.02, 0.0, rate))


def _places(
    piece: Trajectory, network: Network | None, row: Ints, ahead: Floats, speed: Floats
) -> tuple[NDArray[np.int32], Floats]:
    labels = piece.labels("edge_id")
    if network is None or not len(labels.names):
        return np.full(len(row), -1, np.int32), np.zeros(len(row))
    edge = labels.recode(network.index)[row]
    offset = np.nan_to_num(piece.floats("edge_offset"))[row] + ahead * speed
    length = network.length[np.maximum(edge, 0)]
    return edge, np.clip(offset, 0.0, length)


def _slope(
    piece: Trajectory, network: Network | None, edge: NDArray[np.int32], offset: Floats, row: Ints
) -> Floats:
    if network is None or not network.has_elevation:
        return np.zeros(len(row))
    return np.where(edge >= 0, network.slope(np.maximum(edge, 0), offset), 0.0)
