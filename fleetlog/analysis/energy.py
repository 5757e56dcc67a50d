"""Energy per trip, truck, shift and road, and its breakdown by physical cause."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.analysis.energybook.book import Book, keep_book
from fleetlog.analysis.energybook.cells import Cells
from fleetlog.analysis.energybook.doubt import parameter_variance
from fleetlog.analysis.energybook.tables import (
    segment_table,
    shift_names,
    stretch_table,
    summed,
    with_soc,
    zone_table,
)
from fleetlog.core.arguments import ShiftHours
from fleetlog.core.result import Bars, EdgeValues, Result, Series, Shape
from fleetlog.core.truck import Truck
from fleetlog.core.words import count, percent
from fleetlog.errors import DataError
from fleetlog.physics.battery import BatteryModel, battery_of
from fleetlog.physics.power import Physics
from fleetlog.store.dataset import Dataset
from fleetlog.store.days import each_day

Floats = NDArray[np.float64]
SHIFTS = (6, 14, 22)
"""Hours of the day (UTC) at which shifts begin, unless said otherwise."""
ROW_COST = 4e-6
"""What the books of a row cost [s]."""
MOST_POINTS = 2000
"""Of a curve over time."""
COLUMNS = (
    "x", "y", "z", "speed", "edge_id", "edge_offset", "lateral_offset", "trip_id", "payload", "fork_height",
    "battery_power", "battery_voltage", "battery_current", "soc", "ambient_temperature",
)  # fmt: skip


def energy(
    dataset: Dataset, truck: Truck, physics: Physics | None = None, *,
    shifts: Annotated[tuple[int, ...], ShiftHours()] = SHIFTS,
    chemistry: Literal["constant", "lfp", "lead"] = "constant",
) -> Result:  # fmt: skip
    """Compute the energy of every trip by physical cause, beside what was measured.

    Parameters
    ----------
    physics : physics that diagnose found (model.toml or its folder); the nominal model by default.
    shifts : hours of the day (UTC) at which shifts begin.
    chemistry : of the battery: shape of its voltage over the state of charge.
    """
    if not dataset.rows:
        raise DataError(f"{dataset.path} has no rows")
    physics = Physics(truck) if physics is None else physics
    battery = battery_of(physics.actual_truck(), chemistry)
    books = list(_books(dataset, physics, battery))
    terms = _term_order(books)
    segments = with_soc(segment_table(books, terms), truck)
    segments["shift"] = shift_names(segments["hour"], sorted(shifts))
    doubt = parameter_variance(physics)
    tables = {
        "trips": summed(segments, ["vehicle_id", "trip_id"], doubt),
        "vehicles": summed(segments, ["vehicle_id"], doubt),
        "shifts": summed(segments, ["shift"], doubt),
        "hours": summed(
            segments.assign(hour=pd.to_datetime(segments["hour"], unit="us", utc=True)), ["hour"], doubt
        ),
        "edges": stretch_table(books, dataset.site.network),
        "zones": zone_table(books, terms, dataset.site),
    }
    whole = summed(segments.assign(all="all"), ["all"], doubt).iloc[0]
    trips = segments.drop_duplicates(["vehicle_id", "trip_id"])["source"].value_counts().sort_index()
    sources = {str(s): int(n) for s, n in trips.items()}
    summary = _summary(whole, terms, sources, tables)
    shapes = _shapes(books, terms, whole, tables)
    kept = {f"energy_{name}": table for name, table in tables.items() if len(table)}
    places = {name: kept.pop(name) for name in ("energy_edges",) if name in kept}
    return Result("energy", summary, kept, places, shapes, _lines(whole, terms, sources, tables))


def _books(dataset: Dataset, physics: Physics, battery: BatteryModel) -> Iterator[Book]:
    """The books of all vehicle-days, each of whole trips."""
    days = each_day(
        dataset, _vehicle_day, physics, battery, _sources(physics), kinds=(Book, Cells), cost=ROW_COST
    )
    for books in days:
        yield from books


def _vehicle_day(
    dataset: Dataset,
    vehicle: str,
    date: str,
    physics: Physics,
    battery: BatteryModel,
    _sources: Sequence[str],
) -> list[Book]:
    """The books of one vehicle-day, one a piece of whole trips: bounded memory."""
    from fleetlog.physics.motion import measured_channels, reconstruct

    books = []
    for piece in dataset.pieces(vehicle, date, COLUMNS):
        if len(piece) > 1:
            found = reconstruct(measured_channels(piece, dataset.meta), dataset.site.network, physics.truck)
            own = physics.of(vehicle, piece.time[0] * 1e-6)
            books.append(keep_book(piece, found, own, dataset.site, battery))
    return books


def _sources(physics: Physics) -> list[str]:
    """The code of the terms: a user may change his own between two runs."""
    modules = {t.function.__module__ for t in physics.active() if t.function is not None}
    return [inspect.getsource(sys.modules[name]) for name in sorted(modules) if name in sys.modules]


def _term_order(books: Sequence[Book]) -> list[str]:
    """All terms of the ledger, the dearest first."""
    total: dict[str, float] = {}
    for book in books:
        for name, joules in zip(book.terms, book.energy.sum(axis=0), strict=True):
            total[name] = total.get(name, 0.0) + float(joules)
    if not total:
        raise DataError("no vehicle has two rows on one day")
    return sorted(total, key=lambda name: -abs(total[name]))


def _summary(
    whole: pd.Series, terms: Sequence[str], sources: dict[str, int], tables: dict[str, pd.DataFrame]
) -> dict[str, Any]:
    figures = {
        k: whole[k] for k in whole.index if k not in ("all", "start", "end") and not _is_term(k, terms)
    }
    return {
        "start": whole["start"].isoformat(), "end": whole["end"].isoformat(), **figures,
        "ledger_kwh": {t: whole[f"{t}_kwh"] for t in terms}, "measured_from": sources,
        "trips": len(tables["trips"]), "vehicles": len(tables["vehicles"]),
        "units": {"auxiliary_share": "1", "soc_start": "1", "soc_end": "1", "soc_end_model": "1"},
    }  # fmt: skip


def _is_term(column: str, terms: Sequence[str]) -> bool:
    return column.removesuffix("_kwh") in terms and column.endswith("_kwh")


SAID = {
    "power": "the power channel", "voltage and current": "voltage times current",
    "soc": "the change of the state of charge",
}  # fmt: skip


def _lines(
    whole: pd.Series, terms: Sequence[str], sources: dict[str, int], tables: dict[str, pd.DataFrame]
) -> list[str]:
    total = whole["energy_kwh"]
    per_km = f", {whole['kwh_per_km']:.3f} kWh/km" if np.isfinite(whole["kwh_per_km"]) else ""
    trips = count(len(tables["trips"]), "trip")
    out = [
        f"{trips} of {count(len(tables['vehicles']), 'truck')} took {total:.2f} kWh"
        f" (95 % interval ± {1.96 * whole['deviation_kwh']:.2f}): {whole['distance_km']:.1f} km"
        f" in {whole['duration_h']:.1f} h{per_km}."
    ]
    shares = ", ".join(f"{t.replace('_', ' ')} {whole[f'{t}_kwh']:.2f}" for t in terms if whole[f"{t}_kwh"])
    out.append(f"Breakdown in kWh: {shares}.")
    auxiliary = whole["auxiliary_share"]
    out.append(
        f"Recovered: {whole['regenerated_kwh'] + 0.0:.2f} kWh; highest power {whole['peak_power_kw']:.1f} kW"
        + (f"; auxiliary loads take {percent(auxiliary)}." if np.isfinite(auxiliary) else ".")
    )
    if np.isfinite(whole["measured_kwh"]) and whole["measured_kwh"]:
        share = whole["difference_kwh"] / whole["measured_kwh"]
        out.append(
            f"Where energy was measured: {whole['measured_kwh']:.2f} kWh measured, "
            f"{whole['model_beside_measured_kwh']:.2f} kWh modelled ({100.0 * share:+.1f} %)."
        )
    if whole["collapsed_s"] > 0.0:
        out.append(
            f"The voltage collapses (to {whole['lowest_voltage_v']:.1f} V) for {whole['collapsed_s']:.0f} s: "
            "the model asks for more power than the battery can give."
        )
    known = [f"{SAID[s]} ({count(n, 'trip')})" for s, n in sources.items() if s != "nothing"]
    without = sources.get("nothing", 0)
    if known:
        rest = f"; {count(without, 'trip')} had none" if without else ""
        out.append(f"Measured energy comes from {', '.join(known)}{rest}.")
    else:
        out.append("The log has no electrical channel: nothing was measured, the figures are the model's.")
    return out


def _shapes(
    books: Sequence[Book], terms: Sequence[str], whole: pd.Series, tables: dict[str, pd.DataFrame]
) -> list[Shape]:
    shapes: list[Shape] = []
    edges = tables["edges"]
    if len(edges):
        shapes.append(
            EdgeValues(
                "energy_per_metre", edges["edge"].to_numpy(np.int32), edges["from"].to_numpy(float),
                edges["to"].to_numpy(float), edges["joules_per_metre"].to_numpy(float), "energy [J/m]",
            )
        )  # fmt: skip
    shapes.append(
        Bars(
            "ledger",
            tuple(t.replace("_", " ") for t in terms),
            np.array([whole[f"{t}_kwh"] for t in terms]),
            "energy [kWh]",
        )
    )
    return shapes + _curves(books, terms)


def _curves(books: Sequence[Book], terms: Sequence[str]) -> list[Shape]:
    """Fleet power by term over time, stacked, and measured beside modelled."""
    time = np.concatenate([b.bins for b in books])
    width = max(60_000_000, (int(np.ptp(time)) // MOST_POINTS // 60_000_000 + 1) * 60_000_000)
    keys, inverse = np.unique(time // width, return_inverse=True)

    def mean(values: list[Floats]) -> Floats:
        """Mean power over each step [kW]."""
        return np.bincount(inverse, np.concatenate(values), len(keys)) / (width * 1e-6) / 1000.0

    none = np.zeros(0)
    rows = {
        t: mean(
            [
                b.bin_energy[:, b.terms.index(t)] if t in b.terms else none + np.zeros(len(b.bins))
                for b in books
            ]
        )
        for t in terms
    }
    middle = keys * width + width // 2
    out: list[Shape] = [
        Series("ledger_power", middle, rows, "time", "power [kW]", over_time=True, stacked=True)
    ]
    measured, beside, known = (mean([b.bin_measured[:, k] for b in books]) for k in range(3))
    if known.any():
        # The model of the trucks and times that were measured, and of no others.
        both = {
            name: np.where(known > 0.0, v, np.nan) for name, v in (("measured", measured), ("model", beside))
        }
        out.append(Series("power", middle, both, "time", "power [kW]", over_time=True))
    return out


ANALYSIS = energy
