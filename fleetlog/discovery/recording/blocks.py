"""The rows of a vehicle-day as finely stepped motion, small enough to keep for many days, and its windows.

The weak form: power becomes energy over windows of about ten seconds that never straddle a trip.  Noise
averages out, accelerations telescope, and windows are nearly independent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.motion import Motion, join
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.discovery.recording.day import DAY, renewed
from fleetlog.physics.motion import Reconstruction, reconstruct

TRIP = 1_000_000  # Trip codes count on from this much of each vehicle
ROUNDED = 1e-3  # Seconds between samples that are no silence: steps are kept in single precision
EXACT = ("time", "x", "y")  # What of a motion is kept in double precision: it may be far from its origin
WHOLE = ("vehicle", "day", "known")  # What of a block is no array


def picked(table: Any, index: Any, *but: str) -> dict[str, Any]:
    """Return some of every array of a dataclass, by name; ``but`` those that are not aligned."""
    return {f.name: getattr(table, f.name)[index] for f in fields(table) if f.name not in but}


def stacked(tables: Sequence[Any], *but: str) -> dict[str, Any]:
    """Return the arrays of several dataclasses of one kind end to end, by name; ``but`` those told apart."""
    names = [f.name for f in fields(tables[0]) if f.name not in but]
    return {n: np.concatenate([getattr(t, n) for t in tables]) for n in names}


def counted_on(pieces: Sequence[NDArray[Any]], sizes: Sequence[float]) -> NDArray[Any]:
    """Return arrays end to end, the numbers in each counted on from the sizes of those before it."""
    return np.concatenate([p + b for p, b in zip(pieces, np.cumsum([0, *sizes]), strict=False)])


@dataclass(frozen=True)
class Block:
    """Rows of one vehicle on one day.

    motion : (n,) samples, in single precision but for ``EXACT``;  row : (n,) the row that each belongs to,
    growing.
    likely : (n,) the likeliest accelerations, which those of ``motion`` lie above and below.
    time, seconds, power, soc : (rows,) stamp [s since the epoch], time it stands for [s], the recorded
    channels [W, 1];  since : (rows,) time since the vehicle set off [s], NaN where it stands.
    trip : (rows,) codes, unique over vehicles;  vehicle, day : codes.
    known : how well the motion is known, four times the memory of all else; None once it is put away."""

    motion: Motion
    row: Index
    likely: NDArray[np.float32]
    time: Floats
    seconds: Floats
    power: Floats
    soc: Floats
    since: Floats
    trip: Ints
    vehicle: int
    day: int
    known: Reconstruction | None

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, values: Floats) -> Floats:
        """Return the mean of (n,) values over the samples of each row, (rows,)."""
        total = np.bincount(self.row, values * self.motion.dt, len(self))
        return np.asarray(total / np.maximum(self.seconds, 1e-12))

    @property
    def likeliest(self) -> Motion:
        """The motion with the likeliest accelerations."""
        return self.motion.replaced(acceleration=self.likely)

    @cached_property
    def first(self) -> Index:
        """(rows,) the first sample of each row."""
        found = np.searchsorted(self.row, np.arange(len(self), dtype=np.int32))
        return np.minimum(found, len(self.motion) - 1).astype(np.int32)

    @cached_property
    def silence(self) -> Floats:
        """(rows,) for how long the log was silent before a row [s]."""
        m = self.motion
        gap = m.time[1:] - m.time[:-1] - 0.5 * (m.dt[1:] + m.dt[:-1])
        out = np.zeros(len(self))
        out[self.row[1:][gap > ROUNDED]] = gap[gap > ROUNDED]
        return out


def block(
    trajectory: Trajectory, vehicle: int, network: Network | None, truck: Truck, *, lag: float = 0.0,
    scale: float = 1.0, load_lags: bool = False,
) -> Block:  # fmt: skip
    """Return one vehicle-day, its sensors put right by ``lag`` [s] and ``scale``."""
    r = reconstruct(trajectory, network, truck, lag, scale, load_lags=load_lags)
    time = np.asarray(trajectory.time * 1e-6, dtype=np.float64)
    power = np.zeros(len(time))
    power[r.row] = r.motion.power
    moves = np.bincount(r.row, r.motion.speed * r.motion.dt, len(time)) > 0.0
    stood = np.maximum.accumulate(np.where(moves, -np.inf, time))
    motion = narrow(r.motion.replaced(time=r.motion.time + time[0], vehicle=np.full(len(r.motion), vehicle)))
    return Block(
        motion, r.row.astype(np.int32), r.likeliest.acceleration.astype(np.float32), time, r.dt_row, power,
        trajectory.floats("soc"), np.where(moves & np.isfinite(stood), time - stood, np.nan),
        trajectory.trip_ids() + TRIP * vehicle, vehicle, int(trajectory.time[0] // DAY), r,
    )  # fmt: skip


def merged(block: Block, mean_of: float, held: float = 0.0) -> Block:
    """Take rows whose power is the mean of the last ``mean_of`` seconds together so that they say it once;
    of fewer, before a trip or a silence ends, the power is not known. The same of rows that repeat a value
    which is ``held`` for so long [s]: it is of the time of the first."""
    several = max(mean_of, held)
    count = round(several / float(np.median(np.diff(block.time)))) if several > 0.0 else 1
    if count <= 1:
        return block
    begin = np.append(True, np.diff(block.trip) != 0) | (block.silence > 0.0)
    if held:
        begin |= renewed(block.power)
    since = np.arange(len(block)) - np.maximum.accumulate(np.where(begin, np.arange(len(block)), 0))
    begin |= since % count == 0
    group, size = np.cumsum(begin) - 1, np.diff(np.append(np.flatnonzero(begin), len(block)))
    last = np.cumsum(size) - 1
    mean = block.power[last]
    return replace(
        block, motion=block.motion.replaced(power=mean[group][block.row]),
        row=group[block.row].astype(np.int32),
        time=block.time[last - size + 1] if held else np.bincount(group, block.time) / size,
        seconds=np.bincount(group, block.seconds).astype(np.float64),
        power=np.where((size == count) | (held > 0.0), mean, np.nan),
        soc=np.bincount(group, block.soc) / size, since=block.since[last - size + 1], trip=block.trip[last],
    )  # fmt: skip


def by_window(of: Ints | Index, column: Ints | Index, values: Floats, count: int, width: int) -> Floats:
    """Return sums of (n,) values by the window ``of`` each and its column (-1: none), (count, width)."""
    on = column >= 0
    total = np.bincount(of[on] * width + column[on], values[on], count * width)
    return np.asarray(total.reshape(count, width), dtype=np.float64)


@dataclass(frozen=True)
class Cut:
    """A block in windows, 0..count-1 in order: ``of_row`` (rows,) those of rows, ``of`` (n,) of samples."""

    block: Block
    of_row: Index
    of: Index
    count: int

    @property
    def motion(self) -> Motion:
        """That of the block, (n,)."""
        return self.block.motion

    @cached_property
    def begin(self) -> Ints:
        """(count,) first sample of every window."""
        return np.searchsorted(self.of, np.arange(self.count))

    @property
    def middle(self) -> Ints:
        """(count,) the sample in the middle."""
        return np.asarray((self.begin + np.append(self.begin[1:], len(self.of)) - 1) // 2)

    @property
    def first(self) -> Ints:
        """(count,) first row of every window."""
        return np.flatnonzero(np.append(True, np.diff(self.of_row) != 0))

    def energy(self, power: Floats) -> Floats:
        """Return the energy of a power along the samples [W], (count,) [kJ]."""
        return np.asarray(np.add.reduceat(power * self.motion.dt, self.begin) * 1e-3, dtype=np.float64)

    def part(self, keep: Mask) -> tuple[Mask, Cut]:
        """Return some of the windows, (W,): which these are, and a cut of them."""
        b, rows, samples = self.block, keep[self.of_row], keep[self.of]
        row, window = ((np.cumsum(kept) - 1).astype(np.int32) for kept in (rows, keep))
        own = picked(b, rows, "motion", "row", "likely", *WHOLE)
        own |= {"motion": narrow(b.motion[samples]), "row": row[b.row[samples]], "likely": b.likely[samples]}
        part = replace(b, known=None, **own)
        return keep, Cut(part, window[self.of_row[rows]], window[self.of[samples]], int(keep.sum()))

    @staticmethod
    def joined(parts: list[Cut]) -> Cut:
        """Return cuts of one vehicle, one after the other."""
        blocks, counts = [c.block for c in parts], [c.count for c in parts]
        row = counted_on([b.row for b in blocks], [len(b) for b in blocks]).astype(np.int32)
        of_row, of = (counted_on([getattr(c, n) for c in parts], counts) for n in ("of_row", "of"))
        motion = narrow(join([b.motion for b in blocks]))
        block = replace(blocks[0], motion=motion, row=row, **stacked(blocks, "motion", "row", *WHOLE))
        return Cut(block, of_row.astype(np.int32), of.astype(np.int32), sum(counts))

    def windows(self) -> Windows:
        """Return where and when they are."""
        b, m, sample = self.block, self.motion, self.middle
        row = (self.first + np.append(self.first[1:], len(b)) - 1) // 2
        return Windows(
            trip=b.trip[row], vehicle=np.full(self.count, b.vehicle), day=np.full(self.count, b.day),
            edge=m.edge[sample].astype(np.int64), duration=np.add.reduceat(m.dt, self.begin),
            distance=np.add.reduceat(m.speed * m.dt, self.begin), x=m.x[sample], y=m.y[sample],
            time=b.time[row],
        )  # fmt: skip


@dataclass(frozen=True)
class Windows:
    """W windows; all arrays are (W,). ``trip``, ``vehicle``, ``day``, ``edge`` are codes (edge -1 off the
    map), ``duration`` [s], ``distance`` [m], ``x``, ``y`` [m] and ``time`` [s] of the middle."""

    trip: Ints
    vehicle: Ints
    day: Ints
    edge: Ints
    duration: Floats
    distance: Floats
    x: Floats
    y: Floats
    time: Floats

    def __len__(self) -> int:
        return len(self.trip)

    def __getitem__(self, index: Any) -> Windows:
        """Return the windows of a mask or index array."""
        return Windows(**picked(self, index))


def narrow(motion: Motion) -> Motion:
    """Return a motion in single precision, seven digits for three or four; constants take no room."""
    kept = {f.name: getattr(motion, f.name) for f in fields(Motion) if f.name not in EXACT}
    return motion.replaced(**{name: _light(values) for name, values in kept.items()})


def _light(values: NDArray[Any]) -> NDArray[Any]:
    few, repeated = values[:: len(values) // 8 + 1], np.broadcast_to(values[:1], values.shape)
    constant = all(np.array_equal(v, repeated[: len(v)], equal_nan=True) for v in (few, values))
    return repeated if constant else values.astype(np.float32 if values.dtype.kind == "f" else np.int32)


def cut(block: Block, width: float) -> Cut:
    """Return windows of about ``width`` seconds within the trips of a block and between its silences."""
    starts = np.flatnonzero(np.concatenate([[True], (np.diff(block.trip) != 0) | (block.silence[1:] > 0.0)]))
    length = np.diff(np.append(starts, len(block)))
    before = np.cumsum(block.seconds) - block.seconds
    since = before - np.repeat(before[starts], length)
    total = np.add.reduceat(block.seconds, starts)
    parts = np.maximum(1, np.rint(total / width)).astype(np.int64)
    share = since / np.maximum(np.repeat(total, length), 1e-9)
    local = np.minimum((share * np.repeat(parts, length)).astype(np.int64), np.repeat(parts, length) - 1)
    base = np.concatenate([[0], np.cumsum(parts)[:-1]])
    # A trip of fewer rows than parts leaves numbers unused; make them dense.
    numbers = np.repeat(base, length) + local
    numbers[1:] = np.where(block.seconds[1:] > 0.0, numbers[1:], numbers[:-1])
    of_row = (np.cumsum(np.diff(numbers, prepend=numbers[:1]) != 0)).astype(np.int32)
    return Cut(block, of_row, of_row[block.row], int(of_row[-1]) + 1)
