"""Where it is busy: time-weighted occupancy, passages, mean speed, energy and standing time, per cell and stretch of road.

A map is a sum over rows, so maps over the same cells add: of days, of vehicles, of shifts.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.result import EdgeValues, Grid, Result, Shape
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.store import Dataset
from fleetlog.store.trips import STANDING_SPEED

LAYERS = ("time", "distance", "energy", "standing", "passages")
Quantity = Literal["occupancy", "passages", "speed", "energy", "standing"]
LABELS = {
    "occupancy": "time [s/m²]", "passages": "passages", "speed": "mean speed [m/s]", "energy": "energy [kJ/m²]",
    "standing": "standing time [s/m²]",
}  # fmt: skip
MAX_GAP = 15.0
STRETCH = 5.0
MAX_CELLS = 25_000_000
LADEN = 25.0

Floats = NDArray[np.float64]


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
    """Sums per cell (5, rows, columns) and per stretch of directed edge (5, bins), and per unit (vehicle-day) time for tests."""

    cells: Cells
    grid: Floats
    edges: Floats
    units: list[Floats]

    def __add__(self, other: HeatMap) -> HeatMap:
        """The map of both; the cells must be the same."""
        if self.cells != other.cells:
            raise DataError("maps over different cells do not add")
        return HeatMap(self.cells, self.grid + other.grid, self.edges + other.edges, self.units + other.units)


def values(layers: Floats, quantity: Quantity, area: float) -> Floats:
    """One quantity from summed layers; NaN where nothing was.  Times and energies are per square metre (``area``) or stretch."""
    time = layers[0]
    per = {
        "occupancy": lambda: time / area,
        "passages": lambda: layers[4],
        "speed": lambda: layers[1] / np.where(time > 0, time, np.nan),
        "energy": lambda: layers[2] / area / 1000.0,
        "standing": lambda: layers[3] / area,
    }[quantity]()
    return np.asarray(np.where(time > 0, per, np.nan), dtype=np.float64)


def cells_of(extents: list[tuple[float, float, float, float]], cell: float) -> Cells:
    """Whole cells around all extents (xmin, ymin, xmax, ymax)."""
    low = np.floor(np.min([e[:2] for e in extents], axis=0) / cell - 1) * cell
    high = np.ceil(np.max([e[2:] for e in extents], axis=0) / cell + 1) * cell
    columns, rows = (int(n) for n in np.round((high - low) / cell))
    if rows * columns > MAX_CELLS:
        raise DataError(f"{rows} x {columns} cells are too many", do="choose a larger --cell")
    return Cells(float(low[0]), float(low[1]), cell, rows, columns)


def extent(dataset: Dataset) -> tuple[float, float, float, float]:
    """xmin, ymin, xmax, ymax of the positions and the roads [m]."""
    boxes = [] if dataset.site.network is None else [dataset.site.network.extent]
    for t in dataset.days(("x", "y")):
        x, y = t.floats("x"), t.floats("y")
        if np.isfinite(x).any():
            boxes.append((float(np.nanmin(x)), float(np.nanmin(y)), float(np.nanmax(x)), float(np.nanmax(y))))
    if not boxes:
        raise DataError("the dataset has no positions")
    low, high = np.min([b[:2] for b in boxes], axis=0), np.max([b[2:] for b in boxes], axis=0)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


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
    from fleetlog.analysis.occupancy.kernels import accumulate, along_edges

    network = dataset.site.network
    first = stretches(network)
    total = np.zeros((5, cells.rows, cells.columns))
    edges = np.zeros((5, int(first[-1])))
    units = []
    for t in dataset.days(("x", "y", "speed", "battery_power", "edge_id", "edge_offset", "payload")):
        if vehicles and t.vehicle_id not in vehicles:
            continue
        use, speed, power = select(t, hours, state), t.floats("speed"), t.floats("battery_power")
        one = np.zeros_like(total)
        accumulate(
            t.floats("x"),
            t.floats("y"),
            t.time,
            speed,
            power,
            STANDING_SPEED,
            use,
            cells.x0,
            cells.y0,
            cells.cell,
            MAX_GAP,
            one,
        )
        total += one
        units.append(one[0])
        if network is not None:
            edge = t.labels("edge_id").recode(network.index)
            offset = np.nan_to_num(t.floats("edge_offset"))
            along_edges(
                edge, offset, t.time, speed, power, STANDING_SPEED, use, first, STRETCH, MAX_GAP, edges
            )
    return HeatMap(cells, total, edges, units)


def difference(a: HeatMap, b: HeatMap, seed: int = 0, draws: int = 400) -> tuple[Floats, NDArray[np.bool_]]:
    """Share of time per cell, a minus b, and where it is significant.

    Each unit (vehicle-day) of either map is resampled whole; a cell counts where its difference lies outside what pooled
    resampling gives, two-sided 5 % after Benjamini and Hochberg over all cells that were ever visited.
    """
    shares = [m.grid[0] / max(m.grid[0].sum(), 1e-12) for m in (a, b)]
    observed = shares[0] - shares[1]
    pool = np.array([u / max(u.sum(), 1e-12) for u in (*a.units, *b.units) if u.sum() > 0])
    seen = np.flatnonzero(pool.sum(axis=0).ravel() > 0)
    flat = pool.reshape(len(pool), -1)[:, seen]
    rng = np.random.default_rng(seed)
    na, nb = max(len(a.units), 1), max(len(b.units), 1)
    null = np.array([
        flat[rng.integers(0, len(flat), na)].mean(axis=0) - flat[rng.integers(0, len(flat), nb)].mean(axis=0)
        for _ in range(draws)
    ])  # fmt: skip
    z = np.abs(observed.ravel()[seen]) / np.maximum(null.std(axis=0), 1e-12)
    from scipy.stats import norm

    p = 2 * norm.sf(z)
    order = np.argsort(p)
    passes = p[order] <= 0.05 * (np.arange(len(p)) + 1) / max(len(p), 1)
    cut = int(np.max(np.flatnonzero(passes), initial=-1))
    mask = np.zeros(observed.size, np.bool_)
    mask[seen[order[: cut + 1]]] = True
    return observed, mask.reshape(observed.shape)


def heatmap(
    dataset: Dataset,
    *,
    cell: float = 1.0,
    quantity: Quantity = "occupancy",
    smooth: float = 0.0,
    hours: tuple[int, int] | None = None,
    vehicles: tuple[str, ...] = (),
    state: str = "all",
    compare: Dataset | None = None,
) -> Result:
    """A heat map over floor and roads.

    Parameters
    ----------
    cell : size of a square cell [m].
    quantity : what is drawn; the tables hold all.
    smooth : standard deviation of a Gaussian blur [m]; 0 for none.
    hours : first and last hour of the day (UTC), the last one excluded.
    state : ``all``, ``laden`` or ``empty``.
    compare : another dataset; the map is then the difference of time shares, with a significance mask.
    """
    for v in vehicles:
        dataset.parts(v)
    boxes = [extent(dataset)] + ([extent(compare)] if compare else [])
    cells = cells_of(boxes, cell)
    here = compute(dataset, cells, hours, vehicles, state)
    if not here.grid[0].any():
        raise DataError("no row is left by this choice of hours, vehicles and load", do="choose a wider one")
    layers = here.grid if not smooth else _blur(here.grid, smooth / cell)
    name = "heatmap"
    grids = [Grid("heat", values(layers, quantity, cell * cell), cells.x0, cells.y0, cell, LABELS[quantity])]
    summary = _summary(dataset, here, quantity, smooth)
    if compare is not None:
        share, mask = difference(here, compute(compare, cells, hours, (), state))
        per_mille = np.where((here.grid[0] > 0) | (share != 0), 1000 * share, np.nan)
        grids = [
            Grid(
                "difference",
                per_mille,
                cells.x0,
                cells.y0,
                cell,
                "share of time, difference [per mille]",
                True,
                mask,
            )
        ]
        summary["compare"] = {
            "other": str(compare.path),
            "significant_cells": int(mask.sum()),
            "moved_share": float(np.abs(share).sum() / 2),
        }
    shapes: list[Shape] = [*grids]
    tables = {"cells": _cell_table(here, grids[0])}
    if dataset.site.network is not None:
        table, shape = _edge_layer(dataset.site.network, here, quantity)
        tables["edges"] = table
        if compare is None:
            shapes.append(shape)
    return Result(name, summary, tables=tables, shapes=shapes, lines=_lines(summary))


def _blur(layers: Floats, sigma: float) -> Floats:
    from scipy.ndimage import gaussian_filter

    return np.stack([gaussian_filter(layer, sigma, mode="constant") for layer in layers])


def _cell_table(here: HeatMap, drawn: Grid) -> pd.DataFrame:
    r, c = np.nonzero(here.grid[0] > 0)
    table = pd.DataFrame({
        "x": here.cells.x0 + (c + 0.5) * here.cells.cell, "y": here.cells.y0 + (r + 0.5) * here.cells.cell,
        **{name: here.grid[i, r, c] for i, name in enumerate(LAYERS)},
    })  # fmt: skip
    if drawn.mask is not None:
        table["difference"], table["significant"] = drawn.values[r, c] / 1000.0, drawn.mask[r, c]
    return table


def _edge_layer(network: Network, here: HeatMap, quantity: Quantity) -> tuple[pd.DataFrame, EdgeValues]:
    first = stretches(network)
    edge = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(first))
    start = np.asarray((np.arange(int(first[-1])) - first[edge]) * STRETCH, dtype=np.float64)
    end = np.minimum(start + STRETCH, network.length[edge])
    table = pd.DataFrame({
        "edge_id": np.array(network.edge_ids, dtype=object)[edge], "from": start, "to": end,
        **{name: here.edges[i] for i, name in enumerate(LAYERS)},
    })  # fmt: skip
    v = values(here.edges, quantity, 1.0)
    seen = np.isfinite(v)
    label = LABELS[quantity].replace("/m²", "")
    return table[seen].reset_index(drop=True), EdgeValues(
        "roads", edge[seen], start[seen], end[seen], v[seen], label
    )


def _summary(dataset: Dataset, here: HeatMap, quantity: Quantity, smooth: float) -> dict[str, Any]:
    time = here.grid[0]
    r, c = np.unravel_index(int(time.argmax()), time.shape)
    cells = here.cells
    return {
        "quantity": quantity, "cell_m": cells.cell, "smooth_m": smooth, "rows": cells.rows, "columns": cells.columns,
        "origin_m": [cells.x0, cells.y0], "vehicle_hours": float(time.sum() / 3600), "distance_km": float(here.grid[1].sum() / 1000),
        "energy_kwh": float(here.grid[2].sum() / 3.6e6), "standing_hours": float(here.grid[3].sum() / 3600),
        "visited_cells": int((time > 0).sum()), "on_roads_share": float(here.edges[0].sum() / max(time.sum(), 1e-9)),
        "busiest": {"x": cells.x0 + (c + 0.5) * cells.cell, "y": cells.y0 + (r + 0.5) * cells.cell, "hours": float(time.max() / 3600)},
        "dataset": str(Path(dataset.path).name),
    }  # fmt: skip


def _lines(s: dict[str, Any]) -> list[str]:
    b = s["busiest"]
    out = [
        f"{s['vehicle_hours']:.1f} vehicle hours on {s['visited_cells']} cells of {s['cell_m']:g} m, "
        f"{s['distance_km']:.1f} km, {s['energy_kwh']:.1f} kWh, {s['standing_hours']:.1f} h standing",
        f"  busiest cell at ({b['x']:.0f}, {b['y']:.0f}) m: {b['hours']:.2f} h",
    ]
    if "compare" in s:
        c = s["compare"]
        out.append(
            f"  against {c['other']}: {c['significant_cells']} cells differ significantly, "
            f"{c['moved_share']:.1%} of the time lies elsewhere"
        )
    return out


def world_file(cells: Cells) -> str:
    """The six lines that place the raster in the site frame: cell size, rotations, centre of the north-west cell [m]."""
    top = cells.y0 + (cells.rows - 0.5) * cells.cell
    return (
        "\n".join(f"{v:.6f}" for v in (cells.cell, 0.0, 0.0, -cells.cell, cells.x0 + cells.cell / 2, top))
        + "\n"
    )


ANALYSIS = heatmap
