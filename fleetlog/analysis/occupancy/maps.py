"""What trucks do where: sums over rows per cell and per stretch of road.

A map is a sum over rows, so maps over the same cells add: of days, of vehicles, of shifts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.store import Dataset
from fleetlog.store.days import each_day
from fleetlog.store.trips import STANDING_SPEED

LAYERS = ("time", "distance", "energy", "standing", "passages", "energy_time")
Quantity = Literal["occupancy", "passages", "speed", "energy", "standing"]
Grouping = Literal["hour", "vehicle", "load"]
LABELS = {
    "occupancy": "time [s/m²]",
    "passages": "passages",
    "speed": "mean speed [m/s]",
    "energy": "energy [kJ/m²]",
    "standing": "standing time [s/m²]",
}
MAX_GAP = 15.0
STRETCH = 5.0
MAX_CELLS = 25_000_000
LADEN = 25.0

COLUMNS = ("x", "y", "speed", "battery_power", "edge_id", "edge_offset", "payload")
ROW_COST = 1e-6
"""What the sums of a row cost [s]."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Cells:
    """The frame of a map: south-west corner [m], cell size [m], rows, columns."""

    x0: float
    y0: float
    cell: float
    rows: int
    columns: int


@dataclass
class HeatMap:
    """Sums per cell (6, rows, columns) and stretch of directed edge (6, bins);
    of every unit (vehicle-day) the cells with time in them and that time, for tests.
    """

    cells: Cells
    grid: Floats
    edges: Floats
    units: list[tuple[Ints, Floats]]

    def __add__(self, other: HeatMap) -> HeatMap:
        """The map of both; the cells must be the same."""
        if self.cells != other.cells:
            raise DataError("maps over different cells do not add")
        return HeatMap(self.cells, self.grid + other.grid, self.edges + other.edges, self.units + other.units)


@dataclass(frozen=True)
class Patch:
    """The sums of one vehicle-day: (k,) rows and columns of the lattice of cells that counts from the origin,
    and their (6, k) sums; the same of stretches.
    """

    row: Ints
    column: Ints
    grid: Floats
    stretch: Ints
    edges: Floats

    def add_to(self, m: HeatMap) -> None:
        """Add the sums to a map."""
        c = m.cells
        row, column = self.row - round(c.y0 / c.cell), self.column - round(c.x0 / c.cell)
        inside = (row >= 0) & (row < c.rows) & (column >= 0) & (column < c.columns)
        cell, sums = (row * c.columns + column)[inside], self.grid[:, inside]
        m.grid.reshape(6, -1)[:, cell] += sums
        m.edges[:, self.stretch] += self.edges
        m.units.append((cell, sums[0]))


def values(layers: Floats, quantity: Quantity, area: float) -> Floats:
    """One quantity from summed layers, NaN where nothing was;
    times and energies per square metre or stretch.
    """
    time, energy = layers[0], known_energy(layers)
    per: dict[Quantity, Callable[[], Floats]] = {
        "occupancy": lambda: time / area,
        "passages": lambda: layers[4],
        "speed": lambda: layers[1] / np.where(time > 0, time, np.nan),
        "energy": lambda: energy / area / 1000.0,
        "standing": lambda: layers[3] / area,
    }
    return np.asarray(np.where(time > 0, per[quantity](), np.nan), dtype=np.float64)


def known_energy(layers: Floats) -> Floats:
    """The energy layer [J]; NaN where no power was known."""
    return np.asarray(np.where(layers[5] > 0, layers[2], np.nan), dtype=np.float64)


def cells_of(extents: list[tuple[float, float, float, float]], cell: float) -> Cells:
    """Whole cells around all extents (xmin, ymin, xmax, ymax)."""
    low = np.floor(np.min([e[:2] for e in extents], axis=0) / cell - 1) * cell
    high = np.ceil(np.max([e[2:] for e in extents], axis=0) / cell + 1) * cell
    columns, rows = (int(n) for n in np.round((high - low) / cell))
    if rows * columns > MAX_CELLS:
        raise DataError(f"{rows} x {columns} cells are too many", do="choose a larger --cell")
    return Cells(float(low[0]), float(low[1]), cell, rows, columns)


def extent(dataset: Dataset) -> Box:
    """xmin, ymin, xmax, ymax of the positions and the roads [m]."""
    boxes = [] if dataset.site.network is None else [dataset.site.network.extent]
    boxes += [b for b in each_day(dataset, _box, kinds=(Cells,), cost=0.2e-6) if b is not None]
    if not boxes:
        raise DataError("the dataset has no positions")
    low, high = np.min([b[:2] for b in boxes], axis=0), np.max([b[2:] for b in boxes], axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _box(dataset: Dataset, vehicle: str, date: str) -> Box | None:
    """The extent of the positions of one vehicle-day."""
    return _box_of(dataset.read(vehicle, date, ("x", "y")))


def _box_of(t: Trajectory) -> Box | None:
    x, y = t.floats("x"), t.floats("y")
    if not np.isfinite(x).any():
        return None
    return float(np.nanmin(x)), float(np.nanmin(y)), float(np.nanmax(x)), float(np.nanmax(y))


def stretches(network: Network | None) -> NDArray[np.int64]:
    """(E + 1,) first stretch of every edge."""
    if network is None:
        return np.zeros(1, np.int64)
    return np.concatenate([[0], np.cumsum(np.maximum(1, np.ceil(network.length / STRETCH)))]).astype(np.int64)


def select(t: Trajectory, hours: tuple[int, int] | None, state: str) -> NDArray[np.bool_]:
    """(N,) rows of the hours of the day [UTC) and the load state ``all``, ``laden`` or ``empty``."""
    use = np.ones(len(t), np.bool_)
    if hours is not None:
        hour = t.time // 3_600_000_000 % 24
        first, last = hours
        use &= (hour >= first) & (hour < last) if first < last else (hour >= first) | (hour < last)
    if state != "all":
        payload = t.floats("payload")
        use &= payload > LADEN if state == "laden" else payload <= LADEN
    return use


def compute(
    dataset: Dataset,
    cells: Cells,
    hours: tuple[int, int] | None = None,
    vehicles: tuple[str, ...] = (),
    state: str = "all",
) -> HeatMap:
    """The sums of a dataset over given cells, vehicle-day by vehicle-day."""
    return compute_by(dataset, cells, None, hours, vehicles, state).get("all", _empty(dataset, cells))


def compute_by(
    dataset: Dataset,
    cells: Cells,
    by: Grouping | None,
    hours: tuple[int, int] | None = None,
    vehicles: tuple[str, ...] = (),
    state: str = "all",
) -> dict[str, HeatMap]:
    """One map a group, in one pass over the rows; the groups' maps add up to the map of all."""
    out: dict[str, HeatMap] = {}
    days = each_day(
        dataset, _patches, cells.cell, by, hours, state, kinds=(Patch,), vehicles=vehicles, cost=ROW_COST
    )
    for patches in days:
        for name, patch in patches.items():
            patch.add_to(out.setdefault(name, _empty(dataset, cells)))
    return dict(sorted(out.items()))


def _empty(dataset: Dataset, cells: Cells) -> HeatMap:
    bins = int(stretches(dataset.site.network)[-1])
    return HeatMap(cells, np.zeros((6, cells.rows, cells.columns)), np.zeros((6, bins)), [])


def _patches(
    dataset: Dataset, vehicle: str, date: str, cell: float, by: Grouping | None,
    hours: tuple[int, int] | None, state: str,
) -> dict[str, Patch]:  # fmt: skip
    """The sums of one vehicle-day, by group."""
    t = dataset.read(vehicle, date, COLUMNS)
    use, box = select(t, hours, state), _box_of(t)
    if box is None:
        return {}
    cells = cells_of([box], cell)
    groups = ((name, use & mine) for name, mine in _GROUPS[by](t))
    return {name: _patch(t, rows, cells, dataset.site.network) for name, rows in groups if rows.any()}


def _patch(t: Trajectory, use: NDArray[np.bool_], c: Cells, network: Network | None) -> Patch:
    from fleetlog.analysis.occupancy.kernels import accumulate, along_edges

    speed, power = t.floats("speed"), t.floats("battery_power")
    grid, edges = np.zeros((6, c.rows, c.columns)), np.zeros((6, int(stretches(network)[-1])))
    accumulate(
        t.floats("x"), t.floats("y"), t.time, speed, power, STANDING_SPEED, use, c.x0, c.y0, c.cell, MAX_GAP,
        grid
    )  # fmt: skip
    if network is not None:
        edge = t.labels("edge_id").recode(network.index)
        offset = np.nan_to_num(t.floats("edge_offset"))
        along_edges(
            edge, offset, t.time, speed, power, STANDING_SPEED, use, stretches(network), STRETCH, MAX_GAP, edges
        )  # fmt: skip
    seen, driven = np.flatnonzero(grid[0] > 0.0), np.flatnonzero(edges[0] > 0.0)
    row, column = np.divmod(seen, c.columns)
    row, column = row + round(c.y0 / c.cell), column + round(c.x0 / c.cell)
    return Patch(row, column, grid.reshape(6, -1)[:, seen], driven, edges[:, driven])


Groups = list[tuple[str, NDArray[np.bool_]]]


def _all(t: Trajectory) -> Groups:
    return [("all", np.ones(len(t), np.bool_))]


def _hours(t: Trajectory) -> Groups:
    hour = t.time // 3_600_000_000 % 24
    return [(f"hour_{h:02d}", hour == h) for h in np.unique(hour).tolist()]


def _vehicle(t: Trajectory) -> Groups:
    return [(t.vehicle_id, np.ones(len(t), np.bool_))]


def _load(t: Trajectory) -> Groups:
    payload = t.floats("payload")
    laden, empty = payload > LADEN, payload <= LADEN
    return [("laden", laden), ("empty", empty), ("load_unknown", ~(laden | empty))]


_GROUPS: dict[Grouping | None, Callable[[Trajectory], Groups]] = {
    None: _all,
    "hour": _hours,
    "vehicle": _vehicle,
    "load": _load,
}
