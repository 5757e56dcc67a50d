"""From a log to motion: speed, acceleration, slope, curvature and lifting speed, with their uncertainty.

Speed and acceleration come from a fixed-interval (Rauch-Tung-Striebel) smoother of the way travelled, never
from differences of positions.  Stated noise: positions and the log's speed carry white noise, the
acceleration dies away under white jerk; the strengths are measured on the log itself
(:mod:`fleetlog.physics.motion.noise`).  The way is that along the matched edges, corners cut, or along the
smoothed positions off the map.  At a standstill speed and acceleration are observed to be zero.  A silence
of the log ends a stretch: no sample stands for it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.physics.motion.channels import Forks, forks, measured_power, payload, slope_from_height
from fleetlog.physics.motion.noise import Noise, Observed, Smoothed, estimate_noise, jerk_strength, smooth
from fleetlog.physics.motion.path import RADIUS, Path, Track, by_second, follow, mean_curvature, track_of
from fleetlog.physics.motion.rows import STANDING, Rows, against_odometer, read_rows, speed_is_mean

Numbers = Index | Ints

SQUARE = 0.8
"""Mean square of what is taken for the error of an acceleration, as a share of its variance.  With 1, noisy
speeds give 2 % too much energy; with the least, 2 / pi, losses with its square a third too little."""
FINEST = 0.25  # Length of a step that resolves a braking truck [s]
STEERING = 0.85  # Half the length over which the wheel is turned [m]: curvature is a mean over it
TRACK = 2.5  # The same off the map [m]: it divides the noise of the positions


@dataclass(frozen=True)
class Reconstruction:
    """The motion in a log of N rows, as n samples fine enough for a model of power, and how well it is known.
    No sample is longer than 0.25 s while the truck moves. The accelerations of ``motion`` lie above and below
    what is likeliest in turn (:attr:`likeliest`), so that a sum of power over samples is its expectation."""

    motion: Motion
    row: Ints  # (n,) that each sample belongs to, growing
    dt_row: Floats  # (N,) seconds that each row stands for; 0 across gaps
    speed_sd: Floats  # (n,) standard deviation [m/s]
    acceleration_sd: Floats  # (n,) standard deviation [m/s2]
    standing: Mask  # (n,) whether the truck is slower than ``STANDING``, by what the whole log says
    noise: Noise  # What was measured of the channels
    node: Ints  # (n,) place of the samples among ...
    states: Smoothed  # ... the smoothed states
    interval: Ints  # (n,) between which rows a sample lies
    lift_doubt: Floats  # (N - 1,) share of a lift there that may lie in either half

    def rows(self, values: Floats) -> Floats:
        """(N,) sums over the samples of each row."""
        return np.asarray(np.bincount(self.row, values, len(self.dt_row)), dtype=np.float64)

    @property
    def likeliest(self) -> Motion:
        """The motion without the spread of its accelerations: what power costs less on it is what sampling
        hides, no noise that averages out."""
        return self.motion.replaced(acceleration=np.where(self.standing, 0.0, self.states.mean[self.node, 2]))

    def window_variance(self, power: Callable[[Motion], Floats], window: Numbers) -> Floats:
        """(W,) variance [J2] of the energy of every window that the doubt about speed and acceleration makes.

        ``power`` [W] of a motion; ``window`` (n,) number of the window of each sample, growing, -1 in none.
        The slopes of power are those of secants one standard deviation to either side, over its kink."""
        from fleetlog.physics.motion.kernels.filter import energy_variance

        nodes, count = len(self.states.cov), int(window.max(initial=-1)) + 1
        by_speed, by_acceleration = np.zeros((2, nodes))
        by_speed[self.node] = self._secant(power, "speed", self.speed_sd) * self.motion.dt
        by_change = self._secant(power, "acceleration", self.acceleration_sd)
        by_acceleration[self.node] = by_change * self.motion.dt
        near = window[np.minimum(np.searchsorted(self.node, np.arange(nodes)), len(self.node) - 1)]
        near, moved = near.astype(np.int64, copy=False), np.zeros(count)
        energy_variance(self.states.cov, self.states.gain, by_speed, by_acceleration, near, moved)
        return np.asarray(moved + self._lift_variance(power, window, count))

    def _lift_variance(self, power: Callable[[Motion], Floats], window: Numbers, count: int) -> Floats:
        """(W,) that of lifts between the last row of a window and the first of the next, either's."""
        if not self.lift_doubt.any():
            return np.zeros(count)
        lifting = power(self.motion) - power(self.motion.replaced(lift_speed=np.zeros(len(self.motion))))
        lifted = np.bincount(self.interval, lifting * self.motion.dt, len(self.dt_row) + 1)[1:-1]
        of_row = np.full(len(self.dt_row), -1)
        of_row[self.row] = window
        before, after = of_row[:-1], of_row[1:]
        cut = before != after
        out = np.zeros(count + 1)
        for side in (before, after):
            np.add.at(out, side[cut], (lifted * self.lift_doubt)[cut] ** 2)
        return out[:count]

    def _secant(self, power: Callable[[Motion], Floats], name: str, size: Floats) -> Floats:
        size = np.where(self.standing, 0.0, np.maximum(size, 1e-4))
        value = self.states.mean[self.node, 1 if name == "speed" else 2]
        high, low = value + size, np.maximum(value - size, 1e-3 if name == "speed" else -np.inf)
        change = power(self.motion.replaced(**{name: high})) - power(self.motion.replaced(**{name: low}))
        return np.where(self.standing, 0.0, change / np.maximum(high - low, 1e-6))


def reconstruct(
    trajectory: Trajectory, network: Network | None = None, truck: Truck | None = None, lag: float = 0.0,
    scale: float = 1.0, *, noise: Noise | None = None, load_lags: bool = False,
) -> Reconstruction:  # fmt: skip
    """Reconstruct the motion in a log of one vehicle.

    trajectory : with x and y, or speed; ``edge_id`` and ``edge_offset`` where it was matched.
    network : that it was matched to; without it the positions are the path.
    truck : whose turning radius rounds the corners of the map.
    lag : seconds that the power channel runs behind positions and speed; ``load_lags``: load and fork
        height run with it.
    scale : what the speed channel reads over the truth.
    noise : of the channels, measured on the log by default.

    :class:`DataError` where the log has neither positions nor speeds."""
    if not len(trajectory):
        return _nothing(noise or Noise())
    rows = read_rows(trajectory, network, scale)
    track = track_of(rows) if trajectory.has("x") and (rows.edge < 0).any() else None
    radius = RADIUS if truck is None else truck.chassis.turn_radius
    path = follow(network, rows, track, radius)
    longer, lost = against_odometer(rows, path.seen, path.link != 0)
    leaps = np.flatnonzero(lost & (path.link == 0))
    path.link[leaps] = 1
    seen = by_second(rows.t, np.where(rows.fresh, path.seen / longer, np.nan), path.link)
    observed = Observed(rows.t, seen, rows.speed, rows.rest, path.link)
    mean_over = 0.0
    if speed_is_mean(rows, path.seen):
        observed, mean_over = observed.with_mean_speed(), float(np.median(np.diff(rows.t)))
    noise = noise or estimate_noise(observed, Noise(), mean_over)
    mast = forks(rows.t, trajectory)
    grid = sample_grid(rows, mast.at(rows.t), lag)
    nodes, node = observed.at(grid.moment)
    states = smooth(nodes, noise, jerk_strength(observed, noise)[np.searchsorted(observed.t, nodes.t)])
    standing = nodes.rest[node] | (states.mean[node, 1] < STANDING)
    speed_sd, acceleration_sd = (
        np.where(standing, 0.0, np.sqrt(np.maximum(states.cov[node, k], 0.0))) for k in (3, 5)
    )
    way, speed, acceleration = states.mean[node].T
    speed = np.where(standing, 0.0, speed)
    acceleration = np.where(standing, 0.0, acceleration + _spread(acceleration_sd))
    way, step = way * longer, speed * grid.dt
    after = np.searchsorted(grid.moment[:-1], rows.t[leaps])
    curvature = path.curvature(way, step, np.maximum(0.5 * step, STEERING), after[after > 0], radius)
    motion = assembled(
        trajectory, network, rows, path, track, mast, grid, way, speed, acceleration, curvature,
        load_lags=load_lags,
    )  # fmt: skip
    interval = grid.row + (grid.time > rows.t[grid.row])
    return Reconstruction(
        motion, grid.row, np.add(*row_spans(rows)), speed_sd, acceleration_sd, standing, noise, node, states,
        interval, mast.doubt,
    )  # fmt: skip


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
    grid: Grid, way: Floats, speed: Floats, acceleration: Floats, curvature: Floats, *, load_lags: bool,
) -> Motion:  # fmt: skip
    """The motion of n samples, from the (n,) ways driven, speeds and what the log says then."""
    from fleetlog.physics.motion.kernels.way import on_edges

    t, row, moment = rows.t, grid.row, grid.moment
    edge, offset = path.on_map(way)
    half, off = np.maximum(0.5 * speed * grid.dt, STEERING), edge < 0
    heading, slope, _ = shape = np.zeros((3, len(way)))
    if network is not None and not off.all():
        on_edges(edge, offset, way, way, network.points, network.first, network.distance, shape)
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


def _nothing(noise: Noise) -> Reconstruction:
    none, index = np.zeros(0), np.zeros(0, np.int64)
    states = Smoothed(np.zeros((0, 3)), np.zeros((0, 6)), np.zeros((0, 9), np.float32))
    return Reconstruction(Motion.of(0), index, none, none, none, none > 0, noise, index, states, index, none)


def _spread(deviation: Floats) -> Floats:
    """(n,) up and down by this standard deviation, so that a row keeps its mean: of its samples (large,
    small, small, large) the outer and the inner ones cancel.

    Power has a kink where traction turns into braking, and losses grow with the square of the force: their
    expectation is more than their value at the likeliest.  The mean size is that of a normal.  The mean
    square is ``SQUARE`` of it: errors gather where trucks begin to brake, and are smaller on the way, where
    large ones would turn traction into braking."""
    mean = np.sqrt(2.0 / np.pi)
    far, near = mean + (rest := np.sqrt(SQUARE - mean**2)), mean - rest
    turns = [far, -near, near, -far, -near, far, -far, near]
    return np.asarray(deviation * np.resize(turns, len(deviation)))
