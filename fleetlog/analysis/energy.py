"""Energy per trip, truck, shift and road, and its breakdown by physical cause."""

import inspect
import sys
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, Literal

import numpy as np
import pandas as pd

from fleetlog.analysis import energybook as of
from fleetlog.analysis.energybook import BIN, SOURCES, Book, gathered, keep_book
from fleetlog.core.arguments import ShiftHours
from fleetlog.core.arrays import Floats, levels
from fleetlog.core.result import Bars, EdgeValues, Result, Series, Shape
from fleetlog.core.truck import Truck
from fleetlog.core.words import Sentences, count, percent, wrong_sign
from fleetlog.errors import DataError
from fleetlog.physics.battery import BatteryModel, battery_of
from fleetlog.physics.motion import measured_channels, reconstruct
from fleetlog.physics.power import Physics, cause
from fleetlog.store.dataset import Dataset
from fleetlog.store.days import each_day

SHIFTS = (6, 14, 22)  # Hours of the day (UTC) at which shifts begin, unless said otherwise
ROW_COST = 4e-6  # What the books of a row cost [s]
MOST_POINTS = 2000  # Of a curve over time
SAID = Sentences(__file__)
COLUMNS = (
    "x", "y", "z", "speed", "edge_id", "edge_offset", "lateral_offset", "trip_id", "payload", "fork_height",
    "battery_power", "battery_voltage", "battery_current", "soc", "ambient_temperature", "charging",
)  # fmt: skip


def energy(
    dataset: Dataset, truck: Truck, physics: Physics | None = None, *, shifts: ShiftHours = SHIFTS,
    chemistry: Literal["constant", "lfp", "lead"] = "constant",
) -> Result:  # fmt: skip
    """Compute the energy of every trip by physical cause, beside what was measured.

    Parameters
    ----------
    physics : physics that diagnose found (model.toml or its folder); the nominal model by default.
    shifts : hours of the day (UTC) at which shifts begin.
    chemistry : chemistry of the battery, which shapes its voltage over the state of charge."""
    if not dataset.rows:
        raise DataError(f"{dataset.path} has no rows")
    physics = Physics(truck) if physics is None else physics
    # The code of the terms, too: a user may change his own between two runs.
    modules = {t.function.__module__ for t in physics.active if t.function is not None}
    code = [inspect.getsource(sys.modules[name]) for name in sorted(modules) if name in sys.modules]
    asked = physics, battery_of(physics.actual_truck, chemistry), code
    days = each_day(dataset, _vehicle_day, *asked, kinds=(Book,), cost=ROW_COST, joined=True)
    if not (books := [book for day in days for book in day]):
        raise DataError("no vehicle has two rows")
    segments, stretches, zones, bins = (gathered(books, f.name) for f in fields(Book))
    # The dearest term first.
    total = segments.filter(like="J_").sum().abs().sort_values(ascending=False, kind="stable")
    terms = [name.removeprefix("J_") for name in total.index]
    segments = segments[[*segments.columns.difference(total.index, sort=False), *total.index]]
    segments["shift"] = of.shift_names(segments["hour"], sorted(shifts))
    segments["hour"], segments["all"] = pd.to_datetime(segments["hour"], unit="us", utc=True), "all"
    keys = {
        "trips": ["vehicle_id", "trip_id"], "vehicles": ["vehicle_id"], "shifts": ["shift"],
        "hours": ["hour"], "all": ["all"],
    }  # fmt: skip
    tables = {name: of.summed(segments, by, physics) for name, by in keys.items()}
    whole = tables.pop("all").iloc[0]
    edges = tables["edges"] = of.stretch_table(stretches, dataset.site.network)
    tables["zones"] = of.zone_table(zones, terms, dataset.site)
    best = segments.assign(best=segments["source"].map([*SOURCES].index)).groupby(keys["trips"])["best"].min()
    sources = {name: n for k, name in enumerate(SOURCES) if (n := int((best == k).sum()))}
    start, end, ledger = whole["start"].isoformat(), whole["end"].isoformat(), [f"{t}_kwh" for t in terms]
    summary = {
        "start": start, "end": end, **whole.drop(["all", "start", "end", *ledger]),
        **{name: None for name in ("soc_start", "soc_end", "soc_end_model") if np.isnan(whole[name])},
        "ledger_kwh": dict(zip(terms, whole[ledger], strict=True)), "measured_from": sources,
        "trips": len(tables["trips"]), "vehicles": len(tables["vehicles"]),
        "units": {"auxiliary_share": "1", "soc_start": "1", "soc_end": "1", "soc_end_model": "1"},
    }  # fmt: skip
    kept = {f"energy_{name}": table for name, table in tables.items() if len(table)}
    places = {name: kept.pop(name) for name in ("energy_edges",) if name in kept}
    shapes, lines = _shapes(bins, summary["ledger_kwh"], edges), _lines(summary)
    # The state of charge is no power: what it gains while driving is its noise.
    driven = segments[(segments["source"] != "soc") & (segments["metres"] > 1.0)]
    by_power = driven.groupby("vehicle_id")["measured"].sum()
    if turned := by_power.index[by_power < 0.0].tolist():
        lines.append(f"{(note := wrong_sign(turned))[0].upper()}{note[1:]}.")
    return Result("energy", summary, kept, places, shapes, lines)


def _vehicle_day(
    dataset: Dataset, vehicle: str, date: str, physics: Physics, battery: BatteryModel, _code: Sequence[str]
) -> list[Book]:
    """The books of one vehicle-day up to the next row, one a piece of whole trips: bounded memory."""
    books = []
    for piece in dataset.pieces(vehicle, date, COLUMNS, joined=True):
        if len(piece) > 1:
            found = reconstruct(measured_channels(piece, dataset.meta), dataset.site.network, physics.truck)
            own = physics.of(vehicle, piece.time[0] * 1e-6)
            books.append(keep_book(piece, found, own, dataset.site, battery))
    return books


def _lines(s: dict[str, Any]) -> list[str]:
    per_km = f", {s['kwh_per_km']:.3f} kWh/km" if np.isfinite(s["kwh_per_km"]) else ""
    causes = {t: kwh for t, kwh in s["ledger_kwh"].items() if abs(kwh) >= 0.005}
    shares = ", ".join(f"{cause(t)} {kwh:.2f}" for t, kwh in causes.items())
    auxiliary = s["auxiliary_share"]
    loads = f"; auxiliary loads take {percent(auxiliary)}" if np.isfinite(auxiliary) else ""
    model = SAID("model", **s, half_width=1.96 * s["deviation_kwh"], per_km=per_km)
    recovered = SAID("recovered", **s, recovered_kwh=s["regenerated_kwh"] + 0.0, loads=loads)
    out = [model, f"Breakdown in kWh: {shares}.", recovered]
    if np.isfinite(s["measured_kwh"]) and s["measured_kwh"]:
        share = round(100.0 * s["difference_kwh"] / s["measured_kwh"], 1) + 0.0  # No -0.0
        out.append(SAID("measured", **s, share=share))
    if s["collapsed_s"] > 0.0:
        out.append(SAID("collapse", **s))
    sources = dict(s["measured_from"])
    none = sources.pop("nothing", 0)
    known = ", ".join(f"{SOURCES[source]} ({count(n, 'trip')})" for source, n in sources.items())
    if not known:
        return [*out, "The log has no electrical channel: nothing was measured, the figures are the model's."]
    rest = f"; {count(none, 'trip')} had none" if none else ""
    return [*out, f"Measured energy comes from {known}{rest}."]


def _shapes(bins: pd.DataFrame, ledger: dict[str, float], edges: pd.DataFrame) -> list[Shape]:
    shapes: list[Shape] = []
    if len(edges):
        start, end, joules = edges[["from", "to", "joules_per_metre"]].to_numpy(float).T
        edge = edges["edge"].to_numpy(np.int32)
        per_km, name = joules / 3600.0, "energy per kilometre by direction"  # 1 J/m: 1/3600 kWh/km
        shapes.append(EdgeValues(name, edge, start, end, per_km, "energy [kWh/km]"))
    known = {t: e for t, e in ledger.items() if abs(e) > 1e-4 * sum(map(abs, ledger.values()))} or ledger
    kwh, causes = np.array([*known.values()]), tuple(map(cause, known))
    return [*shapes, Bars("energy by cause", causes, kwh, "energy [kWh]"), *_curves(bins, [*known])]


def _curves(bins: pd.DataFrame, terms: Sequence[str]) -> Iterator[Shape]:
    """Fleet power by term over time, stacked, and measured beside modelled."""
    width = (len(levels(bins["time"] // BIN)) // MOST_POINTS + 1) * BIN
    keys, inverse = np.unique(bins["time"] // width, return_inverse=True)

    def mean(name: str) -> Floats:
        """Mean power over each step [kW]."""
        return np.bincount(inverse, bins[name], len(keys)) / (width * 1e-6) / 1000.0

    middle, axes = keys * width + width // 2, ("time", "power [kW]")
    rows = {cause(t): mean(f"J_{t}") for t in terms}
    yield Series("power by cause", middle, rows, *axes, over_time=True, stacked=True)
    if (known := mean("known") > 0.0).any():
        # The model of the trucks and times that were measured, and of no others.
        pair = {"measured": mean("measured"), "model": mean("beside_measured")}
        both = {name: np.where(known, v, np.nan) for name, v in pair.items()}
        yield Series("power, measured and modelled", middle, both, *axes, over_time=True, counts=True)
