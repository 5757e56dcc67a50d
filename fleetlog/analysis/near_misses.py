"""Near misses between trucks: time to collision and post-encroachment time.

A truck is a capsule, ``length`` by ``width``: two discs at its ends stand for it on a collision course.

- *Time to collision* (Hayward 1972): how long until two trucks touch if both go on as they do.
- *Post-encroachment time* (Allen, Shin and Cooper 1978): how long after one truck has left a spot of the
  floor another one comes to it on a crossing way.

Both need clocks that agree among the trucks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.core.arguments import Between
from fleetlog.core.result import Marks, Result
from fleetlog.core.trajectory import Floats, Ints, Trajectory
from fleetlog.core.words import count
from fleetlog.store import Dataset

STEP = 0.25
"""Of the common time grid [s]."""
LONGEST_GAP = 5.0
"""A truck that is silent for longer is absent [s]."""
CELL = 1.0
"""Side of a spot on the floor [m]."""
SAME = 5.0
"""Two moments of one pair within this are one near miss [s]."""
MOVING = 0.5
"""A truck that is slower does not cross another's way [m/s]."""
CHUNK = int(600.0 / STEP)
"""Steps that are compared at once."""
COLUMNS = ("x", "y", "heading", "speed")
TABLE = ("start", "vehicle_a", "vehicle_b", "ttc_s", "pet_s", "kind", "closing_speed", "x", "y")
WORST = 12


@dataclass(frozen=True)
class Moving:
    """The fleet on a grid: (V, T) positions [m], direction (unit vector), speed [m/s]; NaN where absent."""

    start: int
    x: Floats
    y: Floats
    east: Floats
    north: Floats
    speed: Floats

    def steps(self, first: int, end: int) -> Moving:
        """The steps from ``first`` to ``end``."""
        rows = (getattr(self, n)[:, first:end] for n in ("x", "y", "east", "north", "speed"))
        return Moving(self.start + first * round(STEP * 1e6), *rows)


def near_misses(
    dataset: Dataset, *, ttc: Annotated[float, Between(0.0, 60.0)] = 1.0,
    pet: Annotated[float, Between(0.0, 60.0)] = 1.0, closing: Annotated[float, Between(0.0, 60.0)] = 1.0,
    length: Annotated[float, Between(0.1, 30.0)] = 2.5, width: Annotated[float, Between(0.1, 10.0)] = 1.2,
) -> Result:  # fmt: skip
    """Find pairs of trucks that came close to a collision.

    Parameters
    ----------
    ttc : times to collision below this count (s).
    pet : post-encroachment times below this count (s).
    closing : least speed at which two trucks approach one another (m/s).
    length : of a truck (m).
    width : of a truck (m).

    Returns
    -------
    Result
        Table ``near_misses`` (``TABLE``; s, m/s, m; NaN where an indicator does not apply), in order of time.
    """
    found = [np.zeros((0, len(RAW)))]
    for fleet in _fleets(dataset):
        for first in range(0, fleet.x.shape[1], CHUNK):
            part = fleet.steps(first, first + CHUNK + round(pet / STEP))
            found.append(_collisions(part, ttc, closing, length, width))
            # Two grids, as a way along the border of cells is in either of them.
            found += [_crossings(part, pet, length, shift) for shift in (0.0, 0.5 * CELL)]
    table = _events(np.concatenate(found), dataset.vehicles)
    worst = table.assign(worst=table[["ttc_s", "pet_s"]].min(axis=1)).nsmallest(WORST, "worst")
    at, labels = worst[["x", "y"]].to_numpy(float), tuple(f"{v:.1f} s" for v in worst["worst"])
    marks = Marks("near misses", at, labels, np.full(len(worst), 1.0), "critical")
    kinds = {str(k): int(n) for k, n in table["kind"].value_counts().sort_index().items()}
    summary = {
        "ttc_s": ttc, "pet_s": pet, "closing_m_s": closing, "vehicles": len(dataset.vehicles),
        "near_misses": len(table), "kinds": kinds,
    }  # fmt: skip
    return Result("near_misses", summary, {}, {"near_misses": table}, [marks], _lines(summary, table))


def _lines(s: dict[str, Any], table: pd.DataFrame) -> list[str]:
    if s["vehicles"] < 2:
        return ["Near misses are between trucks: one alone has none."]
    rule = f"time to collision under {s['ttc_s']:g} s, or crossing within {s['pet_s']:g} s of one another"
    if not len(table):
        return [f"No near miss between two trucks ({rule})."]
    pairs = table.groupby(["vehicle_a", "vehicle_b"]).size().sort_values(ascending=False, kind="stable")
    a, b = pairs.index[0]
    most = f"; {pairs.iloc[0]} of them between {a} and {b}" if pairs.iloc[0] > 1 else ""
    return [f"{count(len(table), 'near miss', 'near misses')} between two trucks ({rule}){most}."]


def _fleets(dataset: Dataset) -> Iterator[Moving]:
    """The fleet on a grid, day by day."""
    for date in dataset.dates:
        rows = [dataset.read(v, date, COLUMNS) for v in dataset.vehicles]
        known = [t for t in rows if len(t)]
        start, end = min(t.time[0] for t in known), max(t.time[-1] for t in known)
        step = round(STEP * 1e6)
        grid = np.arange(start // step, end // step + 1) * step
        yield Moving(int(grid[0]), *np.stack([_gridded(t, grid) for t in rows], axis=1))


def _gridded(t: Trajectory, grid: Ints) -> Floats:
    """(5, T) position, direction and speed of a truck."""
    x, y, heading, speed = (t.floats(c) for c in COLUMNS)
    use = np.isfinite(x) & np.isfinite(y) & np.isfinite(heading)
    if use.sum() < 2:
        return np.full((5, len(grid)), np.nan)
    time = t.time[use]
    east, north = np.cos(heading[use]), np.sin(heading[use])
    rows = [np.interp(grid, time, v) for v in (x[use], y[use], east, north, np.nan_to_num(speed[use]))]
    norm = np.maximum(np.hypot(rows[2], rows[3]), 1e-9)
    rows[2], rows[3] = rows[2] / norm, rows[3] / norm
    after = np.searchsorted(time, grid)
    inside = (after > 0) & (after < len(time)) | np.isin(grid, time)
    gap = time[np.clip(after, 0, len(time) - 1)] - time[np.clip(after - 1, 0, len(time) - 1)]
    return np.where(inside & (gap <= LONGEST_GAP * 1e6), np.stack(rows), np.nan)


RAW = ("time", "a", "b", "ttc", "pet", "angle", "closing", "x", "y")


def _collisions(f: Moving, most: float, closing: float, length: float, width: float) -> Floats:
    """(n, RAW) moments in which two trucks are on a collision course."""
    from scipy.spatial import cKDTree

    v, step = np.nonzero(np.isfinite(f.x))
    if len(v) < 2:
        return np.zeros((0, len(RAW)))
    at, ahead = np.stack([f.x, f.y], -1)[v, step], np.stack([f.east, f.north], -1)[v, step]
    speed = f.speed[v, step]
    reach = most * 2.0 * float(speed.max()) + length
    # Steps lie farther apart than the reach, so that neighbours are of one step.
    tree = cKDTree(np.column_stack([at, step * 2.0 * (reach + 1.0)]))
    pairs = tree.query_pairs(reach, output_type="ndarray")
    pairs = np.sort(pairs[np.maximum(*speed[pairs].T) > MOVING], axis=1)
    a, b = pairs.T
    gap, relative = at[b] - at[a], ahead[b] * speed[b, None] - ahead[a] * speed[a, None]
    nose = 0.5 * (length - width)
    times = [
        time_to_contact(gap + nose * (j * ahead[b] - i * ahead[a]), relative, width)
        for i in (-1.0, 1.0) for j in (-1.0, 1.0)
    ]  # fmt: skip
    soon = np.min(times, axis=0)
    rate = -(gap * relative).sum(axis=1) / np.maximum(np.hypot(*gap.T), 1e-9)
    apart = np.all([t >= 0.0 for t in times], axis=0)
    keep = apart & (soon < most) & (rate >= closing)
    a, b, middle = a[keep], b[keep], (0.5 * (at[a] + at[b]))[keep]
    nan = np.full(len(a), np.nan)
    time = f.start * 1e-6 + step[a] * STEP
    rows = (time, v[a], v[b], soon[keep], nan, _angle(ahead[a], ahead[b]), rate[keep], *middle.T)
    return np.column_stack(rows)


def time_to_contact(gap: Floats, velocity: Floats, distance: float) -> Floats:
    """(N,) seconds until points with a ``gap`` ((N, 2) m) and relative ``velocity`` are ``distance`` apart.

    inf where they never are; -1 where they are closer already.
    """
    a, b = (velocity**2).sum(axis=1), (gap * velocity).sum(axis=1)
    c = (gap**2).sum(axis=1) - distance**2
    root = b * b - a * c
    meets = (root >= 0.0) & (b < 0.0)
    when = np.where(meets, (-b - np.sqrt(np.maximum(root, 0.0))) / np.maximum(a, 1e-12), np.inf)
    return np.asarray(np.where(c < 0.0, -1.0, when))


def _angle(a: Floats, b: Floats) -> Floats:
    """(N,) between two directions of travel, 0 to pi."""
    return np.asarray(np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0)))


def _crossings(f: Moving, most: float, length: float, shift: float) -> Floats:
    """(n, RAW) a truck comes to a spot soon after another one has left it, on a crossing way."""
    cell, vehicle, start, end, east, north, speed, x, y = _visits(f, length, shift)
    one, two = np.arange(len(cell) - 1), np.arange(1, len(cell))
    wait = (start[two] - end[one]) * STEP
    ahead = np.stack([east, north], axis=-1)
    turn = _angle(ahead[one], ahead[two]) if len(one) else np.zeros(0)
    # Directions less than 30 degrees apart, or nearly opposite, are of one lane or of two.
    keep = (cell[one] == cell[two]) & (vehicle[one] != vehicle[two]) & (wait > 0.0) & (wait < most)
    keep &= (np.sin(turn) > 0.5) & (np.minimum(speed[one], speed[two]) > MOVING)
    one, two = one[keep], two[keep]
    low, high = np.minimum(vehicle[one], vehicle[two]), np.maximum(vehicle[one], vehicle[two])
    closing = np.hypot(*(ahead[two] * speed[two, None] - ahead[one] * speed[one, None]).T)
    time, nan = f.start * 1e-6 + start[two] * STEP, np.full(len(one), np.nan)
    return np.column_stack([time, low, high, nan, wait[keep], turn[keep], closing, x[two], y[two]])


def _visits(f: Moving, length: float, shift: float) -> tuple[NDArray[Any], ...]:
    """Cells under the middle line of trucks: number, vehicle, first and last step, direction, speed, place.

    In order of cell and time.
    """
    v, step = np.nonzero(np.isfinite(f.x))
    if not len(v):
        return tuple(np.zeros(0) for _ in range(9))
    along = np.linspace(-0.5, 0.5, int(np.ceil(length / (0.5 * CELL))) + 1)[:, None] * length
    east, north, speed = (m[v, step] for m in (f.east, f.north, f.speed))
    x, y = (f.x[v, step] + along * east).ravel(), (f.y[v, step] + along * north).ravel()
    column, row = (np.floor((v + shift) / CELL).astype(np.int64) for v in (x, y))
    cell = (column - column.min()) * (row.max() - row.min() + 1) + row - row.min()
    east, north, speed = (np.tile(m, len(along)) for m in (east, north, speed))
    order = np.lexsort((np.tile(step, len(along)), np.tile(v, len(along)), cell))
    cell, v, step = cell[order], np.tile(v, len(along))[order], np.tile(step, len(along))[order]
    new = np.diff(cell, prepend=-1) != 0
    new |= (np.diff(v, prepend=-1) != 0) | (np.diff(step, prepend=-9) > 2)
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(cell)) - 1
    rows = [m[order][first] for m in (east, north, speed, x, y)]
    out = (cell[first], v[first], step[first], step[last], *rows)
    by_time = np.lexsort((out[2], out[0]))
    return tuple(m[by_time] for m in out)


def _events(found: Floats, names: list[str]) -> pd.DataFrame:
    """One row a near miss: moments of one pair close together are one, with the lowest of each indicator."""
    raw = pd.DataFrame(found, columns=list(RAW)).sort_values(["a", "b", "time"], ignore_index=True)
    new = (raw[["a", "b"]].diff().abs().sum(axis=1) > 0.0) | (raw["time"].diff() > SAME)
    groups = raw.groupby(new.cumsum())
    worst = raw.loc[raw[["ttc", "pet"]].min(axis=1).groupby(new.cumsum()).idxmin()] if len(raw) else raw
    first = groups["time"].min()
    out = pd.DataFrame({
        "start": pd.to_datetime((first * 1e6).round().astype("int64").to_numpy(), unit="us", utc=True),
        "vehicle_a": [names[int(k)] for k in worst["a"]], "vehicle_b": [names[int(k)] for k in worst["b"]],
        "ttc_s": groups["ttc"].min().to_numpy(), "pet_s": groups["pet"].min().to_numpy(),
        "kind": _kinds(worst["angle"].to_numpy()), "closing_speed": worst["closing"].to_numpy(),
        "x": worst["x"].to_numpy(), "y": worst["y"].to_numpy(),
    }, columns=list(TABLE))  # fmt: skip
    return out.sort_values(["start", "vehicle_a", "vehicle_b"], ignore_index=True)


def _kinds(angle: Floats) -> NDArray[np.object_]:
    names = np.array(["behind", "crossing", "head-on"], dtype=object)
    return np.asarray(names[np.digitize(angle, np.radians([30.0, 150.0]))])


ANALYSIS = near_misses
