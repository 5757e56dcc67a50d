"""Heat maps: time, passages, mean speed, energy and standing time, on the floor and on the roads."""

import functools
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter

from fleetlog.analysis import occupancy as maps
from fleetlog.analysis.apart import settled
from fleetlog.analysis.occupancy import Grouping, HeatMap, Quantity
from fleetlog.core.arguments import Between, HourRange
from fleetlog.core.arrays import Floats, Mask, levels
from fleetlog.core.result import EdgeValues, Grid, Result, Shape
from fleetlog.core.words import Sentences, count, listed, percent
from fleetlog.errors import ArgumentError, DataError
from fleetlog.store import Dataset

SAID = Sentences(__file__)


def heatmap(
    dataset: Dataset, *, cell: Annotated[float, Between(0.01, 1e6)] = 1.0, quantity: Quantity = "occupancy",
    smooth: Annotated[float, Between(0.0, 1e4)] = 0.0, hours: HourRange | None = None,
    vehicle: tuple[str, ...] = (), load: Literal["all", "laden", "empty"] = "all",
    compare: Dataset | None = None, by: Grouping | None = None,
) -> Result:  # fmt: skip
    """Draw how much time trucks spend where, on the floor and on the roads.

    Parameters
    ----------
    cell : size of a square cell [m].
    quantity : what is drawn; the tables hold all.
    smooth : standard deviation of a Gaussian blur [m]; 0 for none.
    hours : hours of the day (UTC), as 6-14; the last one is excluded.
    load : only trucks in this load state.
    compare : another dataset: draw the difference of time shares, with a significance mask.
    by : one map for each hour of the day (UTC), vehicle or load state, in one colour scale."""
    if by is not None and compare is not None:
        raise ArgumentError("--by and --compare do not go together", do="leave one of them out")
    for v in vehicle:
        dataset.parts(v)
    boxes = [maps.extent(dataset)] + ([maps.extent(compare)] if compare else [])
    groups = maps.compute(dataset, maps.cells_of(boxes, cell), by, hours, vehicle, load)
    if not any(m.units for m in groups.values()):
        what = "no row with a position is left by this choice of hours, vehicles and load"
        raise DataError(what, do="choose a wider one, or import logs with positions")
    here = functools.reduce(HeatMap.__add__, groups.values())
    summary = _summary(dataset, here, quantity, smooth)
    full = {n if by else "heat": m for n, m in groups.items() if m.grid[0].any()}
    shapes: list[Shape] = [_drawn(name, m, quantity, smooth) for name, m in full.items()]
    table = _cell_table(here)
    if by is not None:
        summary["by"] = {name: {"vehicle_hours": float(m.grid[0].sum() / 3600)} for name, m in groups.items()}
        parts = [_cell_table(m).assign(**{by: name}) for name, m in groups.items()]
        table = pd.concat(parts, ignore_index=True)
    if compare is not None:
        there = maps.compute(compare, here.cells, hours=hours, state=load)["all"]
        (share, mask), f = difference(here, there), here.cells
        per_mille = np.where((here.grid[0] > 0) | (share != 0), 1000 * share, np.nan)
        moved, theirs = float(np.abs(share).sum() / 2), str(compare.path)
        summary["compare"] = {"other": theirs, "significant_cells": int(mask.sum()), "moved_share": moved}
        rows = np.nonzero(here.grid[0] > 0)
        table["difference"], table["significant"] = share[rows], mask[rows]
        ours, other = summary["dataset"], Path(theirs).name
        for name, m in ((ours, here), (f"{other} (other)" if other == ours else other, there)):
            spent, label = 1000 * m.grid[0] / max(m.grid[0].sum(), 1e-12), "share of the time [per mille]"
            shapes.append(Grid(name, spent, f.x0, f.y0, f.cell, label))
        label = f"{ours} minus {other} [per mille of the time]"
        shapes = [*shapes[-2:], Grid("difference", per_mille, f.x0, f.y0, f.cell, label, True, mask)]
    tables = {"cells": table}
    if (network := dataset.site.network) is not None:
        values, first = maps.values(here.edges, quantity, 1.0), maps.stretches(network)
        seen = np.flatnonzero(np.isfinite(values))
        edge = np.repeat(np.arange(len(network), dtype=np.int32), np.diff(first))[seen]
        start = np.asarray((seen - first[edge]) * maps.STRETCH, dtype=np.float64)
        end = np.minimum(start + maps.STRETCH, network.length[edge])
        place = {"edge_id": np.array(network.edge_ids, dtype=object)[edge], "from": start, "to": end}
        tables["edges"] = pd.DataFrame({**place, **maps.by_name(here.edges[:, seen])})
        if compare is None and by is None:
            label = maps.LABELS[quantity].replace("/m²", "")
            shapes.append(EdgeValues("roads", edge, start, end, values[seen], label))
    result = Result("heatmap", summary, tables, {}, shapes, _lines(summary), {"cells": cell})
    unknown = "vehicle_hours", "distance_km", "standing_hours", "busiest"
    return settled(result, dataset, "Time by place", *unknown, vehicles=vehicle)


def _drawn(name: str, m: HeatMap, quantity: Quantity, smooth: float) -> Grid:
    c = m.cells
    blurred = gaussian_filter(m.grid, (0.0, smooth / c.cell, smooth / c.cell), mode="constant")
    values = maps.values(blurred, quantity, c.cell * c.cell)
    return Grid(name, values, c.x0, c.y0, c.cell, maps.LABELS[quantity])


def _cell_table(here: HeatMap) -> pd.DataFrame:
    r, c = np.nonzero(here.grid[0] > 0)
    x, y = here.cells.middle(r, c)
    return pd.DataFrame({"x": x, "y": y, **maps.by_name(here.grid[:, r, c])})


def _summary(dataset: Dataset, here: HeatMap, quantity: Quantity, smooth: float) -> dict[str, Any]:
    time, metres, joules, standing, _, known = here.grid
    r, c = np.unravel_index(int(time.argmax()), time.shape)
    cells, total = here.cells, max(time.sum(), 1e-9)
    x, y = cells.middle(r, c)
    return {
        "quantity": quantity, "cell_m": cells.cell, "smooth_m": smooth, "rows": cells.rows,
        "columns": cells.columns, "origin_m": [cells.x0, cells.y0],
        "vehicle_hours": float(time.sum() / 3600), "distance_km": float(metres.sum() / 1000),
        "energy_kwh": float(joules.sum() / 3.6e6) if known.any() else None,
        "energy_known_share": float(known.sum() / total), "standing_hours": float(standing.sum() / 3600),
        "visited_cells": int((time > 0).sum()), "on_roads_share": float(here.edges[0].sum() / total),
        "busiest": {"x": x, "y": y, "hours": float(time.max() / 3600)},
        "dataset": dataset.path.name,
    }  # fmt: skip


def _lines(s: dict[str, Any]) -> list[str]:
    energy, known = "energy unknown", s["energy_known_share"]
    if s["energy_kwh"] is not None:
        part = f" (power known for {percent(known)} of the time)" if known < 0.995 else ""
        energy = f"{s['energy_kwh']:.1f} kWh{part}"
    out = [SAID("busiest", **s), SAID("all", **s, energy=energy)]
    if "by" in s:
        spent = ((n.replace("_", " "), v["vehicle_hours"]) for n, v in s["by"].items())
        hours = [f"{n} {h:.2f} h" for n, h in spent if h]
        out.append(f"Of these hours: {listed(hours[:24])}.")
    if "compare" in s:
        n, moved = s["compare"]["significant_cells"], percent(s["compare"]["moved_share"], 1)
        cells = f"{count(n, 'cell')} {'differs' if n == 1 else 'differ'}" if n else "no cell differs"
        what = f"{cells} by more than chance; in all, {moved} of the time is spent elsewhere"
        out.insert(0, f"Compared with {Path(s['compare']['other']).name}, {what}.")
    return out


def difference(a: HeatMap, b: HeatMap, seed: int = 0, draws: int = 400) -> tuple[Floats, Mask]:
    """Share of time per cell, a minus b, and where it is significant. Each unit (vehicle-day) of either map
    is resampled whole; a cell counts where its difference lies outside what pooled resampling gives,
    two-sided 5 % after Benjamini and Hochberg over all cells that were ever visited."""
    shares = [m.grid[0] / max(m.grid[0].sum(), 1e-12) for m in (a, b)]
    observed = shares[0] - shares[1]
    units = [(cell, time) for cell, time in (*a.units, *b.units) if len(cell)]
    seen = levels(np.concatenate([cell for cell, _ in units]))
    flat = np.zeros((len(units), len(seen)))
    for row, (cell, time) in zip(flat, units, strict=True):
        row[np.searchsorted(seen, cell)] = time / time.sum()
    rng = np.random.default_rng(seed)

    def resampled(m: HeatMap) -> Floats:
        """Mean shares of as many units as a map has, drawn from all."""
        return np.asarray(flat[rng.integers(0, len(flat), max(len(m.units), 1))].mean(axis=0))

    null = np.array([resampled(a) - resampled(b) for _ in range(draws)])
    from scipy.stats import false_discovery_control, norm

    z = np.abs(observed.ravel()[seen]) / np.maximum(null.std(axis=0), 1e-12)
    mask = np.zeros(observed.size, np.bool_)
    mask[seen] = false_discovery_control(2 * norm.sf(z)) <= 0.05
    return observed, mask.reshape(observed.shape)
