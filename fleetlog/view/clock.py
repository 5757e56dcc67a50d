"""What a recording shows: all time, one day, or no silences; which rows; what of the floor must be seen."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fleetlog.core.arrays import Floats, Ints, levels
from fleetlog.core.result import Flows, Grid, Marks, MovingLines, Result
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import InputError
from fleetlog.store import Dataset

SKIPPED = "gaps skipped"  # Name of the timeline without silences: weeks play as their shifts
MINUTE = 60_000_000  # [us]
QUIET = 30  # A silence of the whole fleet longer than this is skipped [minutes]
MOST_LINES, MOST_DAYS = 20, 7  # Periods that the summary names, and days that an error names
GAP = 10_000_000  # A silence longer than this [us], and than five sampling intervals, is shown as a gap
Extent = tuple[float, float, float, float]  # xmin, ymin, xmax, ymax [m]


class OneDay(Dataset):
    """A dataset as if it held the rows of one day (UTC, YYYY-MM-DD) alone."""

    def __init__(self, path: str | Path, date: str) -> None:
        super().__init__(path)
        if date not in self.dates:
            more = f" and {len(self.dates) - MOST_DAYS} more" if self.dates[MOST_DAYS:] else ""
            do = f"choose from {', '.join(self.dates[:MOST_DAYS])}{more}"
            raise InputError(f"no rows on {date} (UTC)", where=path, do=do)
        self.dates = [date]
        self.vehicle_days = [day for day in self.vehicle_days if day[1] == date]
        times = {t.vehicle_id: t.time for t in self.days(())}
        start, end = int(min(t[0] for t in times.values())), int(max(t[-1] for t in times.values()))
        self.meta |= {
            "start": f"{np.datetime64(start, 'us')}Z", "end": f"{np.datetime64(end, 'us')}Z",
            "rows": sum(map(len, times.values())),
            "vehicles": {name: about for name, about in self.meta["vehicles"].items() if name in times},
        }  # fmt: skip


def opened(path: str | Path, day: str | None) -> Dataset:
    """The dataset, or one ``day`` of it."""
    return Dataset(path) if day is None else OneDay(path, day)


@dataclass(frozen=True)
class Clock:
    """The periods with data: ``starts`` and ``ends`` (N,) [us]."""

    starts: Ints
    ends: Ints

    def __call__(self, time: Ints) -> Ints:
        """(M,) time since the first start, silences left out [us]."""
        before = np.cumsum(self.ends - self.starts) - (self.ends - self.starts)
        k = np.maximum(np.searchsorted(self.starts, time, side="right") - 1, 0)
        return np.asarray(before[k] + np.clip(time, self.starts[k], self.ends[k]) - self.starts[k])

    @property
    def seconds(self) -> float:
        """Length of all periods."""
        return float((self.ends - self.starts).sum()) * 1e-6

    def lines(self) -> list[str]:
        """When each period begins, on either timeline."""
        out = [f"{len(self.starts)} periods with data, which the timeline *{SKIPPED}* plays in turn:"]
        for start, at in zip(self.starts[:MOST_LINES], self(self.starts[:MOST_LINES]), strict=True):
            shown = str(np.datetime64(int(start), "us"))[:16].replace("T", " ")
            out.append(f"{int(at) // 60 // MINUTE}:{int(at) // MINUTE % 60:02d} h is {shown} UTC")
        more = len(self.starts) - MOST_LINES
        return [*out, f"and {more} more"] if more > 0 else out


def clock_of(dataset: Dataset) -> Clock | None:
    """The clock that skips the silences of a recording; None where it has none."""
    if dataset.kind != "recorded":
        return None
    days = (t.time // MINUTE for t in dataset.days(()))  # in order: np.unique alone would not know it
    minutes = [day[np.diff(day, prepend=day[:1] - 1) > 0] for day in days]
    return skipping(np.unique(np.concatenate([np.zeros(0, np.int64), *minutes])))


def skipping(minutes: Ints) -> Clock | None:
    """The clock that skips what is between minutes with data ((N,) in order); None where that is nothing."""
    steps = np.diff(minutes)
    later = np.flatnonzero(steps > max(QUIET, 2.0 * float(np.median(steps)))) if len(steps) else steps
    if not len(later):
        return None
    starts, ends = minutes[np.append(0, later + 1)], minutes[np.append(later, len(minutes) - 1)] + 1
    return Clock(starts * MINUTE, ends * MINUTE)


def rows_at_rate(time: Ints, rate_hz: float) -> Ints:
    """Indices of the first row in every interval of 1/rate, and of the last row."""
    bins = time // max(round(1e6 / rate_hz), 1)
    return together(np.flatnonzero(np.diff(bins, prepend=bins[:1] - 1)), np.arange(len(time))[-1:])


def gap_limit(time: Ints) -> int:
    """Longest step between rows [us] that does not count as a gap."""
    return max(GAP, 5 * int(np.median(np.diff(time)))) if len(time) > 1 else GAP


def thinned(trajectory: Trajectory, rate_hz: float) -> Trajectory:
    """The trajectory at no more than ``rate_hz``; rows beside a gap are always kept."""
    time = trajectory.time
    before = np.flatnonzero(np.diff(time) > gap_limit(time))
    return trajectory[together(rows_at_rate(time, rate_hz), before, before + 1)]


def together(*indices: ArrayLike) -> Ints:
    """The indices that are in any of the sets, in order."""
    return np.asarray(levels(np.concatenate([np.asarray(these, np.int64) for these in indices])))


def changed(values: Floats, step: float) -> Ints:
    """Indices at which a value has moved by ``step`` or more, or turns to or from NaN."""
    level = np.where(np.isnan(values), -(10**9), np.floor(np.nan_to_num(values) / step + 0.5))
    return np.flatnonzero(np.diff(level, prepend=np.inf) != 0)


def moved(step: float, *values: Floats) -> Ints:
    """Indices at which any value moved by ``step``, the rows before (a truck stood till then), both ends."""
    at, every = [changed(v, step) for v in values], np.arange(len(values[0]))
    return together(every[:1], every[-1:], *at, *(np.maximum(k - 1, 0) for k in at))


def pieces(time: Ints, limit: int) -> list[slice]:
    """The stretches of rows without a gap."""
    cuts = [0, *(np.flatnonzero(np.diff(time) > limit) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in itertools.pairwise(cuts) if b > a]


def around(outline: Floats) -> Extent:
    """The rectangle about points (N, 2 or 3); 20 m about the origin where there is none."""
    if not len(outline):
        return (-10.0, -10.0, 10.0, 10.0)
    (x0, y0), (x1, y1) = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _stack(parts: Sequence[Any]) -> Floats:
    """(N, 3) finite points of parts (..., 2 or 3); the floor is at height 0."""
    flat = [np.asarray(p, float).reshape(-1, np.shape(p)[-1]) for p in parts if np.size(p)]
    whole = np.concatenate([np.zeros((0, 3)), *(np.pad(p, ((0, 0), (0, 3 - p.shape[1]))) for p in flat)])
    return np.asarray(whole[np.isfinite(whole).all(axis=1)], dtype=np.float64)


def _site_parts(site: Site) -> list[Any]:
    parts: list[Any] = [z.polygon[:, :2] for z in site.zones]
    parts += [np.column_stack([b.polygon[:, :2], np.full(len(b.polygon), b.height)]) for b in site.buildings]
    parts += [(p.x, p.y) for p in site.places]
    return parts if site.network is None else [*parts, site.network.points]


def dataset_outline(dataset: Dataset) -> Floats:
    """(N, 3) points that must be seen [m]: of the site, or without a map also of the positions driven."""
    parts = _site_parts(dataset.site)
    for t in dataset.days(("x", "y")) if dataset.site.network is None else ():
        if t.has("x") and t.has("y"):
            x, y = ((np.nanmin(t.floats(c)), np.nanmax(t.floats(c))) for c in "xy")
            parts.append(list(itertools.product(x, y)))
    return _stack(parts)


def shapes_outline(result: Result, site: Site) -> Floats:
    """(N, 3) points that must be seen [m]: of the site and of everything that a result draws on it."""
    parts = _site_parts(site)
    for shape in result.shapes:
        if isinstance(shape, Marks):
            parts.append(shape.xy)
        elif isinstance(shape, Flows):
            parts += [shape.start, shape.end]
        elif isinstance(shape, MovingLines):
            parts += shape.lines[:1000]
        elif isinstance(shape, Grid):
            cells = np.argwhere(np.isfinite(shape.values) & (shape.values != 0.0))[:, ::-1]
            ends = [cells.min(axis=0), cells.max(axis=0) + 1] if len(cells) else []
            parts += [np.array([shape.x0, shape.y0]) + shape.cell * end for end in ends]
    return _stack(parts)
