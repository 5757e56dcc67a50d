"""The samples of a motion from the smoothed states and the other channels."""

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Floats, Trajectory
from fleetlog.physics.motion.channels import Forks, measured_power, payload, slope_from_height
from fleetlog.physics.motion.grid import Grid
from fleetlog.physics.motion.path import STEERING, Path, edge_shape
from fleetlog.physics.motion.plane import Plane
from fleetlog.physics.motion.rows import Rows


def assembled(
    trajectory: Trajectory, network: Network | None, rows: Rows, path: Path, plane: Plane | None, mast: Forks,
    grid: Grid, way: Floats, speed: Floats, acceleration: Floats, *, load_lags: bool,
) -> Motion:  # fmt: skip
    """The motion of n samples, from the (n,) ways driven, speeds and what the log says then."""
    t, row, moment = rows.t, grid.row, grid.moment
    edge, offset = path.on_map(way)
    half, off = np.maximum(0.5 * speed * grid.dt, STEERING), edge < 0
    curvature, heading, slope = path.bends.curvature(way, half), np.zeros(len(way)), np.zeros(len(way))
    if network is not None and not off.all():
        heading, slope, _ = edge_shape(network, edge, offset, way, way)
    if plane is not None:
        heading = np.where(off, np.interp(moment, t, plane.heading), heading)
        curvature = np.where(off, plane.curvature(np.interp(moment, t, plane.way), half), curvature)
    if trajectory.has("z") and not (network is not None and network.has_elevation and not off.all()):
        driven = np.interp(t, moment, np.cumsum(speed * grid.dt))
        slope = np.interp(moment, t, slope_from_height(driven, trajectory.floats("z"), rows.link == 2))
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
