"""What a log says of the motion, row by row: positions, speeds, silences and standstills."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError

Codes = NDArray[np.uint8]

SHORTEST_GAP = 10.0  # A silence of this and of five usual intervals ends a stretch [s]
STANDING = 0.05  # Below this speed a truck stands [m/s]: the creep and the noise of a speed sensor at rest
UNSURE_END = 1.5  # Of a standstill that only positions show, at either end left to the smoother [s]
OFF_LANE = 2.0
"""Farther than this from the middle of its road [m], than its noise and twice as far as usual, a truck is
beside it: lanes may be drawn as one line."""
CORNER = 15.0  # From road to road a truck is off their middles on less than this [m]
CHANGES = 0.2  # A change of speed from row to row that shows whether it is a mean [m/s]
LONG = 50.0  # A way over which an odometer and the map are compared [m]
LOST = 2.0  # So much and four times their noise may positions be off the way by the speed from row to row [m]
MOVED = 0.5  # A position that stayed the same while the speed channel drove so far was not measured again [m]


@dataclass(frozen=True)
class Rows:
    """The rows of a log, (N,) each."""

    t: Floats  # [s]
    x: Floats  # [m], interpolated where unknown
    y: Floats
    fresh: Mask  # Whether the position was measured then
    speed: Floats  # [m/s], NaN unknown
    breaks: Mask  # After a silence
    edge: Index  # -1 off the map
    offset: Floats  # [m]

    @cached_property
    def link(self) -> Codes:
        """How a row follows the one before: 0, or 2 after a silence."""
        return np.where(self.breaks, 2, 0).astype(np.uint8)

    @cached_property
    def rest(self) -> Mask:
        """Of a standstill: the speed says so, else the match put them on one spot, else positions stay."""
        from fleetlog.physics.motion.kernels.way import stays

        known = np.isfinite(self.speed)
        rest = known & (self.speed < STANDING)
        if known.all():
            return rest
        equal = (np.diff(self.edge) == 0) & (np.diff(self.offset) == 0.0) & ~self.breaks[1:]
        same = np.append(equal, False) | np.append(False, equal)
        noise = position_noise(self.x, self.y)
        by_place, longest = np.zeros(len(self.t), np.bool_), max(5.0, 12.0 * noise)
        stays(self.t, self.x, self.y, self.link, 3.0 * noise + 0.1, longest, by_place)
        return np.where(known, rest, _inner(self.t, np.where(self.edge >= 0, same, by_place)))


def measured_channels(trajectory: Trajectory, meta: Mapping[str, Any]) -> Trajectory:
    """The trajectory without a speed that import derived from positions, as it says nothing beside them."""
    derived = meta.get("summary", {}).get("derived_by_vehicle", {}).get(trajectory.vehicle_id, ())
    return trajectory.without("speed") if "speed" in derived and trajectory.has("x") else trajectory


def gaps(t: Floats, shortest: float = SHORTEST_GAP) -> Mask:
    """(N - 1,) silences between rows at (N,) times [s]: longer than ``shortest`` and five usual intervals."""
    step = np.diff(t)
    # One step alone does not say what is usual; of two, the longer one may be the silence.
    usual = np.quantile(step, 0.5, method="lower") if len(step) > 1 else 0.0
    return step > max(shortest, 5.0 * float(usual))


def read_rows(trajectory: Trajectory, network: Network | None, scale: float) -> Rows:
    """The rows of a log of one vehicle; ``scale`` is what its speed channel reads over the truth."""
    t, speed = trajectory.seconds(), trajectory.floats("speed") / scale
    # Copies: what Parquet lends may not be written, and kernels would be compiled once for either.
    x, y, offset = (trajectory.floats(name).copy() for name in ("x", "y", "edge_offset"))
    if not np.isfinite(x).any() and not np.isfinite(speed).any():
        what = f"vehicle {trajectory.vehicle_id} has neither positions nor speeds"
        raise DataError(what, do="map one of them in a profile")
    breaks = np.append(True, gaps(t))
    if not (fresh := updates(t, x, y, speed)).any():
        x = y = np.zeros(len(t))
    elif not fresh.all():
        # Between two updates a vehicle moved along the line between them as far as its speed says.
        driven = t if not np.isfinite(speed).any() else metres_driven(t, speed) + 1e-6 * t
        x, y = (np.interp(driven, driven[fresh], v[fresh]) for v in (x, y))
    edge = trajectory.labels("edge_id").recode({} if network is None else network.index)
    # In a bay beside its road the positions are the path.
    beside, moves = np.abs(np.nan_to_num(trajectory.floats("lateral_offset"))), ~(speed < STANDING)
    usual = float(np.median(beside[moves])) if moves.any() else 0.0
    off = beside > max(OFF_LANE, 4.0 * position_noise(x, y), 2.0 * usual)
    edge = np.where(np.isfinite(offset), edge, -1).astype(np.int32)
    if network is not None:
        off &= ~_cut_corners(edge, off, x, y, breaks | (speed < STANDING), network.reverse)
    return Rows(t, x, y, fresh, speed, breaks, np.where(off, -1, edge), np.nan_to_num(offset))


def _cut_corners(edge: Index, off: Mask, x: Floats, y: Floats, other: Mask, reverse: Index) -> Mask:
    """Return the (N,) rows ``off`` the middle of their road on which a truck goes from one road to another,
    and does nothing ``other``: it cuts a corner, or takes it wide, and is on its way."""
    begin, end = np.flatnonzero(np.diff(off, prepend=False, append=False)).reshape(-1, 2).T
    a, b, busy = np.maximum(begin - 1, 0), np.minimum(end, len(off) - 1), np.append(0, np.cumsum(other))
    cut = (edge[a] >= 0) & (edge[b] >= 0) & (edge[a] != edge[b]) & (reverse[edge[a]] != edge[b])
    cut &= (busy[b + 1] == busy[begin]) & (np.hypot(x[b] - x[a], y[b] - y[a]) < CORNER)
    ends = np.bincount(begin[cut], minlength=len(off)) - np.bincount(end[cut], minlength=len(off) + 1)[:-1]
    return np.cumsum(ends) > 0


def updates(t: Floats, x: Floats, y: Floats, speed: Floats) -> Mask:
    """Return the (N,) rows whose position is known and new. A position that is repeated while the speed says
    that the truck moved was not measured again; without a speed, one that is repeated no longer than twice as
    long as is usual in this log."""
    fresh = np.isfinite(x) & np.isfinite(y)
    known = np.flatnonzero(fresh)
    if (new := elsewhere(x[known], y[known])).all():
        return fresh
    run = np.cumsum(new) - 1
    way = metres_driven(t, speed)[known]
    moved = np.abs(way[np.append(np.flatnonzero(new)[1:], len(known) - 1)] - way[new])[run] > MOVED
    lasts = np.diff(np.append(t[known][new], t[known][-1]))
    brief = (lasts <= 2.0 * np.median(lasts))[run] & (np.median(np.bincount(run)) > 1)
    fresh[known] = new | ~np.where(np.isfinite(speed[known]), moved, brief)
    return fresh


def elsewhere(x: Floats, y: Floats) -> Mask:
    """Return the (N,) rows that are not where the row before is; the first is one."""
    return np.append(True, (np.diff(x) != 0.0) | (np.diff(y) != 0.0))


def metres_driven(t: Floats, speed: Floats) -> Floats:
    """Return the (N,) metres since the first row by the speed channel."""
    return np.cumsum(np.append(0.0, np.nan_to_num(0.5 * (speed[1:] + speed[:-1])) * np.diff(t)))


def _inner(t: Floats, rest: Mask) -> Mask:
    """Standstills without their ends: positions cannot tell the last creeping metre from standing."""
    inner = np.zeros(len(rest), np.bool_)
    for begin, end in np.flatnonzero(np.diff(rest, prepend=False, append=False)).reshape(-1, 2).tolist():
        margin = min(UNSURE_END, 0.3 * (t[end - 1] - t[begin]))
        lo, hi = np.searchsorted(t, [t[begin] + margin - 1e-6, t[end - 1] - margin + 1e-6])
        inner[lo:hi] = True
    return inner & rest


def position_noise(x: Floats, y: Floats) -> float:
    """Spread of the noise from row to row, from third differences [m]."""
    third = np.hypot(np.diff(x, 3), np.diff(y, 3))
    # the median of a two-dimensional normal length is 1.1774 sigma
    return float(np.clip(np.median(third) / 1.1774 / np.sqrt(20.0), 0.01, 5.0)) if len(third) > 2 else 0.5


def speed_is_mean(rows: Rows, way: Floats) -> bool:
    """Whether the speed of a row is the mean since the row before, judged by the ``way`` (N,) seen. Then the
    way between two rows is its speed times the step; else it is the mean of both rows' speeds times the step.
    What decides lies where the truck gathers or sheds speed."""
    if len(new := np.flatnonzero(rows.fresh & elsewhere(rows.x, rows.y))) < 2:
        return False
    # Between two new positions: what the speeds of both ends say of the way, and what the mean would add.
    step, change = np.diff(rows.t), np.diff(rows.speed)
    added = np.cumsum(np.append(0.0, np.nan_to_num(0.5 * step * change)))
    unseen = np.cumsum(rows.breaks | np.append(False, np.isnan(change)))
    later, driven, lost = (np.diff(v[new]) for v in (added, metres_driven(rows.t, rows.speed), unseen))
    over = np.diff(way[new]) - driven
    use = (lost == 0) & (np.abs(later) > 0.5 * CHANGES * np.median(step))
    use &= np.isfinite(over) & (np.abs(over) < 2.0 * np.abs(later) + MOVED)
    if use.sum() < 30:
        return False
    size = float(later[use] @ later[use])
    share = float(over[use] @ later[use]) / size
    return share > 0.5 and share > 5.0 * float(np.std(over[use] - share * later[use])) / np.sqrt(size)


def against_odometer(rows: Rows, way: Floats, jumps: Mask) -> tuple[float, Mask]:
    """Metres of ``way`` (N,) that positions show for a metre by the speed channel, 1 where unknown; and the
    (N,) rows whose way since the last known row is not what it says then: a wrong match, or a bay. An
    odometer and a map differ by a per cent or two; the smoother is to know of that of the speed channel."""
    lost = np.zeros(len(way), bool)
    known = np.flatnonzero(np.isfinite(way) & rows.fresh)
    if not len(known) or not np.isfinite(rows.speed).any():
        return 1.0, lost
    way, driven = way[known], metres_driven(rows.t, np.nan_to_num(rows.speed))[known]
    piece = np.cumsum(jumps | ~np.isfinite(rows.speed))[known]
    first = np.flatnonzero(np.diff(np.floor(driven / LONG) + piece * 1e6, prepend=-1.0))
    last = np.append(first[1:], len(known)) - 1
    seen, said = way[last] - way[first], driven[last] - driven[first]
    good = said > 0.5 * LONG
    longer = float(np.median(seen[good] / said[good])) if good.sum() >= 5 else 1.0
    longer = longer if 0.8 < longer < 1.25 else 1.0
    apart = np.abs(np.diff(way / longer) - np.diff(driven))
    lost[known[1:][apart > LOST + 4.0 * position_noise(rows.x, rows.y)]] = True
    return longer, lost
