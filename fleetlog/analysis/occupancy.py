"""What trucks do where: sums over rows per cell and stretch, which add over days, vehicles and shifts."""

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fleetlog.analysis.apart import LONGEST
from fleetlog.core.arrays import HOUR, Floats, Ints, Mask
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.store import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import MIN_LOAD_CHANGE, STANDING_SPEED

LAYERS = ("time", "distance", "energy", "standing", "passages", "energy_time")
Quantity = Literal["occupancy", "passages", "speed", "energy", "standing"]
Grouping = Literal["hour", "vehicle", "load"]
LABELS = {
    "occupancy": "time [s/m²]", "passages": "passages", "speed": "mean speed [m/s]",
    "energy": "energy [kJ/m²]", "standing": "standing time [s/m²]",
}  # fmt: skip
STRETCH = 5.0
MAX_CELLS = 25_000_000
COLUMNS = ("x", "y", "speed", "battery_power", "edge_id", "edge_offset", "payload")
ROW_COST = 1e-6  # What the sums of a row cost [s]


@dataclass(frozen=True)
class Raster:
    """The raster of a map: south-west corner [m], cell size [m], rows, columns."""

    x0: float
    y0: float
    cell: float
    rows: int
    columns: int

    def middle(self, row: Any, column: Any) -> tuple[Any, Any]:
        """East and north of the middle of cells [m]."""
        return self.x0 + (column + 0.5) * self.cell, self.y0 + (row + 0.5) * self.cell


@dataclass
class HeatMap:
    """Sums per cell (6, rows, columns) and stretch (6, bins); ``units``: cells, their time by vehicle-day."""

    cells: Raster
    grid: Floats
    edges: Floats
    units: list[tuple[Ints, Floats]]

    def __add__(self, other: "HeatMap") -> "HeatMap":
        """The map of both, over the same cells."""
        return HeatMap(self.cells, self.grid + other.grid, self.edges + other.edges, self.units + other.units)

    def add(self, p: "Patch") -> None:
        """Add the sums of a vehicle-day."""
        c = self.cells
        row, column = p.row - round(c.y0 / c.cell), p.column - round(c.x0 / c.cell)
        inside = (row >= 0) & (row < c.rows) & (column >= 0) & (column < c.columns)
        cell, sums = (row * c.columns + column)[inside], p.grid[:, inside]
        self.grid.reshape(6, -1)[:, cell] += sums
        self.edges[:, p.stretch] += p.edges
        self.units.append((cell, sums[0]))


@dataclass(frozen=True)
class Patch:
    """Sums (6, k) of a vehicle-day by cell, (k,) rows and columns counted from the origin, and by stretch."""

    row: Ints
    column: Ints
    grid: Floats
    stretch: Ints
    edges: Floats


def values(layers: Floats, quantity: Quantity, area: float) -> Floats:
    """One quantity from summed layers, NaN where nothing was; times and energies by ``area`` [m2]."""
    of, there = by_name(layers), layers[0] > 0
    per = {
        "passages": of["passages"], "standing": of["standing"] / area, "occupancy": of["time"] / area,
        "energy": of["energy"] / area / 1000.0, "speed": of["distance"] / np.where(there, of["time"], np.nan),
    }  # fmt: skip
    return np.asarray(np.where(there, per[quantity], np.nan), dtype=np.float64)


def by_name(layers: Floats) -> dict[str, Floats]:
    """The layers by name; energy [J] is NaN where no power was known."""
    named = dict(zip(LAYERS, layers, strict=True))
    return named | {"energy": np.where(named["energy_time"] > 0, named["energy"], np.nan)}


def cells_of(extents: list[Floats], cell: float) -> Raster:
    """Whole cells around all extents (xmin, ymin, xmax, ymax)."""
    low = np.floor(np.min(extents, axis=0)[:2] / cell - 1) * cell
    high = np.ceil(np.max(extents, axis=0)[2:] / cell + 1) * cell
    columns, rows = (int(n) for n in np.round((high - low) / cell))
    if rows * columns > MAX_CELLS:
        raise DataError(f"{rows} x {columns} cells are too many", do="choose a larger --cell")
    return Raster(float(low[0]), float(low[1]), cell, rows, columns)


def extent(dataset: Dataset) -> Floats:
    """(4,) xmin, ymin, xmax, ymax of the positions and the roads [m]."""
    boxes = [] if dataset.site.network is None else [np.array(dataset.site.network.extent)]
    boxes += [b for b in each_day(dataset, _box, kinds=(Raster,), cost=0.2e-6) if b is not None]
    if not boxes:
        raise DataError("the dataset has no positions", do="import logs with positions")
    return np.array([*np.min(boxes, axis=0)[:2], *np.max(boxes, axis=0)[2:]])


def _box(dataset: Dataset, vehicle: str, date: str) -> Floats | None:
    """(4,) extent of the positions of one vehicle-day."""
    t = dataset.read(vehicle, date, ("x", "y"))
    at = np.stack([t.floats("x"), t.floats("y")])
    if not np.isfinite(at[0]).any():
        return None
    return np.array([*np.nanmin(at, axis=1), *np.nanmax(at, axis=1)])


def stretches(network: Network | None) -> Ints:
    """(E + 1,) first stretch of every edge."""
    if network is None:
        return np.zeros(1, np.int64)
    return np.concatenate([[0], np.cumsum(np.maximum(1, np.ceil(network.length / STRETCH)))]).astype(np.int64)


def select(t: Trajectory, hours: tuple[int, int] | None, state: str) -> Mask:
    """(N,) rows of the hours of the day [UTC) and the load state ``all``, ``laden`` or ``empty``."""
    use = np.ones(len(t), np.bool_)
    if hours is not None:
        hour = t.time // HOUR % 24
        first, last = hours
        use &= (hour >= first) & (hour < last) if first < last else (hour >= first) | (hour < last)
    if state != "all":
        payload = t.floats("payload")
        use &= payload > MIN_LOAD_CHANGE if state == "laden" else payload <= MIN_LOAD_CHANGE
    return use


def compute(
    dataset: Dataset, cells: Raster, by: Grouping | None = None, hours: tuple[int, int] | None = None,
    vehicles: tuple[str, ...] = (), state: str = "all",
) -> dict[str, HeatMap]:  # fmt: skip
    """One map a group, else that of ``all``, be it empty, in one pass; groups' maps add up to that of all."""
    floor, roads = (6, cells.rows, cells.columns), (6, int(stretches(dataset.site.network)[-1]))
    out = defaultdict[str, HeatMap](lambda: HeatMap(cells, np.zeros(floor), np.zeros(roads), []))
    asked = cells.cell, by, hours, state
    for patches in each_day(dataset, _patches, *asked, kinds=(Patch,), vehicles=vehicles, cost=ROW_COST):
        for name, patch in patches.items():
            out[name].add(patch)
    return dict(sorted(out.items())) if by else {"all": out["all"]}


def _patches(
    dataset: Dataset, vehicle: str, date: str, cell: float, by: Grouping | None,
    hours: tuple[int, int] | None, state: str,
) -> dict[str, Patch]:  # fmt: skip
    """The sums of one vehicle-day, by group."""
    t, box = dataset.read(vehicle, date, COLUMNS), _box(dataset, vehicle, date)
    if box is None:
        return {}
    use, cells = select(t, hours, state), cells_of([box], cell)
    groups = {name: use & mine for name, mine in _groups(t, by).items()}
    return {name: _patch(t, rows, cells, dataset.site.network) for name, rows in groups.items() if rows.any()}


def _patch(t: Trajectory, use: Mask, c: Raster, network: Network | None) -> Patch:
    from fleetlog.analysis.kernels import accumulate

    grid = np.zeros((c.rows, c.columns, 6))  # all of a cell lies together
    x, y, speed, power = (t.floats(n).view() for n in ("x", "y", "speed", "battery_power"))
    for column in (x, y, time := t.time.view(), speed, power):
        column.flags.writeable = False  # as those of a file are: for others the kernel would be compiled anew
    step = x, y, time, speed, power, STANDING_SPEED, use
    accumulate(*step, c.x0, c.y0, c.cell, LONGEST, c.columns, grid.reshape(-1, 6))
    edges = np.zeros((6, 0)) if network is None else _along_edges(t, use, network)
    row, column = np.nonzero(grid[:, :, 0] > 0.0)
    driven = np.flatnonzero(edges[0] > 0.0)
    origin = round(c.y0 / c.cell), round(c.x0 / c.cell)
    return Patch(row + origin[0], column + origin[1], grid[row, column].T, driven, edges[:, driven])


def _along_edges(t: Trajectory, use: Mask, network: Network) -> Floats:
    """(6, bins) the layers of every stretch; a row stands for the time after it."""
    first, edge, dt = stretches(network), t.labels("edge_id").recode(network.index), np.diff(t.time) * 1e-6
    number = np.maximum(np.nan_to_num(t.floats("edge_offset")), 0.0) // STRETCH
    place = np.minimum(first[edge] + number, first[edge + 1] - 1)[:-1]
    here = np.where((edge[:-1] >= 0) & (dt > 0.0) & (dt <= LONGEST), place, -1).astype(np.int64)
    v, w = (t.floats(c)[:-1] for c in ("speed", "battery_power"))
    came, known, on = np.diff(here, prepend=-1) != 0, np.isfinite(w), (here >= 0) & use[:-1]
    still = v < STANDING_SPEED
    layers = dt, np.nan_to_num(v) * dt, np.where(known, w, 0.0) * dt, still * dt, came, known * dt
    return np.array([np.bincount(here[on], layer[on], first[-1]) for layer in layers])


def _groups(t: Trajectory, by: Grouping | None) -> dict[str, Mask]:
    """The groups of a vehicle-day and the rows (N,) of each."""
    if by == "hour":
        hour = t.time // HOUR % 24
        return {f"hour_{h:02d}": hour == h for h in np.unique(hour).tolist()}
    if by == "load":
        laden, empty = select(t, None, "laden"), select(t, None, "empty")
        return {"laden": laden, "empty": empty, "load_unknown": ~(laden | empty)}
    return {t.vehicle_id if by == "vehicle" else "all": np.ones(len(t), np.bool_)}
