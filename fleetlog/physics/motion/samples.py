"""The samples of a motion: every row's time in pieces short enough for the convex switch of the drive, and
what the smoothed states and the other channels say of them."""

from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.motion.channels import Forks, measured_power, payload, slope_from_height
from fleetlog.physics.motion.path import Path, Track, mean_curvature
from fleetlog.physics.motion.rows import Rows

FINEST = 0.25  # Length of a step that resolves a braking truck [s]
STEERING = 0.85  # Half the length over which the wheel is turned [m]: curvature is a mean over it
TRACK = 2.5  # The same off the map [m]: it divides the noise of the positions


class Grid(NamedTuple):
    """n samples of some rows, in order of time; (n,) each."""

    row: Ints  # That a sample belongs to
    time: Floats  # Its middle, or its row's stamp [s]
    begin: Floats  # By the clock of the rows [s]
    dt: Floats  # That it stands for, from ``begin`` on [s]
    moment: Floats  # When the truck did what is logged then; earlier where power lags [s]


def row_spans(rows: Rows) -> tuple[Floats, Floats]:
    """(rows,) seconds that each row stands for before and after its stamp: half-way to its neighbours."""
    half = 0.5 * np.where(rows.breaks[1:], 0.0, np.diff(rows.t))
    return np.append(0.0, half), np.append(half, 0.0)


def sample_grid(rows: Rows, height: Floats, lag: float) -> Grid:
    """The samples of rows, none longer than ``FINEST``; one of a row about which nothing moves, neither the
    truck nor its forks, (rows,) at a ``height`` [m]."""
    t, breaks, rest = rows.t, rows.breaks, rows.rest
    still = rest[1:] & rest[:-1] & (np.diff(height) == 0.0) | breaks[1:]
    quiet = rest & np.append(still, True) & np.append(True, still)
    before, after = row_spans(rows)
    whole = quiet | (before + after <= FINEST * (1.0 + 1e-6))
    # The two halves of every row, one after the other; the first one has it all where the row is whole.
    start = np.column_stack([before, np.zeros(len(t))]).ravel()
    length = np.column_stack([np.where(whole, before + after, before), np.where(whole, 0.0, after)]).ravel()
    count = np.ceil(length / FINEST - 1e-6).astype(np.int64)
    count[::2][whole] = 1
    half = np.repeat(np.arange(len(count)), count)
    row, dt = half // 2, (length / np.maximum(count, 1))[half]
    begin = t[row] + (dt * (np.arange(len(half)) - (np.cumsum(count) - count)[half]) - start[half])
    time = np.where(whole[row], t[row], begin + 0.5 * dt)
    # When it was done lies within the stretch of the row.
    first = np.flatnonzero(breaks)
    last, stretch = np.append(first[1:], len(t)) - 1, (np.cumsum(breaks) - 1)[row]
    return Grid(row, time, begin, dt, np.clip(time - lag, t[first][stretch], t[last][stretch]))


def assembled(
    trajectory: Trajectory, network: Network | None, rows: Rows, path: Path, track: Track | None, mast: Forks,
    grid: Grid, way: Floats, speed: Floats, acceleration: Floats, *, load_lags: bool,
) -> Motion:  # fmt: skip
    """The motion of n samples, from the (n,) ways driven, speeds and what the log says then."""
    from fleetlog.physics.motion.kernels.way import on_edges

    t, row, moment = rows.t, grid.row, grid.moment
    edge, offset = path.on_map(way)
    half, off = np.maximum(0.5 * speed * grid.dt, STEERING), edge < 0
    curvature = mean_curvature(way, half, path.bends.driven, path.bends.turned)
    heading, slope = np.zeros((2, len(way)))
    if network is not None and not off.all():
        shape = on_edges(edge, offset, way, way, network.points, network.first, network.distance)
        heading, slope = shape[:2]
    if track is not None:
        heading = np.where(off, np.interp(moment, t, track.heading), heading)
        place, growing = np.interp(moment, t, track.way), track.way + 1e-6 * np.arange(len(t))
        wound = mean_curvature(place, np.maximum(half, TRACK), growing, track.turned)
        curvature = np.where(off, wound, curvature)
    if trajectory.has("z") and not (network is not None and network.has_elevation and not off.all()):
        driven = np.interp(t, moment, np.cumsum(speed * grid.dt))
        slope = np.interp(moment, t, slope_from_height(driven, trajectory.floats("z"), rows.breaks))
    late = 0.0 if load_lags else grid.time - moment
    # Whose load it is: of the row that power is of, or of the one nearest to the moment.
    own = row if load_lags else np.searchsorted(0.5 * (t[1:] + t[:-1]), moment)
    return Motion(
        time=grid.time, dt=grid.dt, speed=speed, acceleration=acceleration, slope=slope,
        curvature=curvature, heading=heading, payload=payload(t, trajectory)[own],
        lift_speed=mast.speed(grid.begin - late, grid.dt), fork_height=mast.at(grid.time - late),
        x=np.interp(moment, t, rows.x), y=np.interp(moment, t, rows.y),
        edge=edge, edge_offset=np.where(off, 0.0, offset),
        ambient_temperature=trajectory.floats("ambient_temperature")[row], soc=trajectory.floats("soc")[row],
        vehicle=np.zeros(len(way), np.int64), trip=trajectory.trip_ids()[row],
        power=measured_power(trajectory)[row],
    )  # fmt: skip
