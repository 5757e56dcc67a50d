"""Trips: from where to where, how far, how long, how much energy."""

from typing import Annotated, Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from fleetlog.core.arguments import Between
from fleetlog.core.result import Bars, Flows, Marks, Result
from fleetlog.core.words import Sentences, count
from fleetlog.errors import DataError
from fleetlog.simulate.places import MIN_CHARGE
from fleetlog.store import Dataset
from fleetlog.store.trips import MIN_LOAD_CHANGE

MEANS = "distance_m", "duration_s", "driving_time_s"
NEAR = 8.0  # Trip ends this close to a place are at it [m]
SAID = Sentences(__file__)
SQUARE, MOST_FLOWS = 10.0, 25  # Squares in place of places where a site has none [m]; arrows drawn


def trips(dataset: Dataset, *, min_distance: Annotated[float, Between(0.0, 1e6)] = 5.0) -> Result:
    """List the trips: from where to where, how far, how long, how much energy.

    Parameters
    ----------
    min_distance : shorter trips are shunting: counted, but left out of the means [m]."""
    if not len(table := dataset.trips):
        raise DataError("the dataset has no trips", where=dataset.path)
    table = table.assign(from_place=_places(dataset, table, "start"), to_place=_places(dataset, table, "end"))
    real = table[table.distance >= min_distance]
    energy = real.energy.to_numpy(float) / 3600.0
    known = np.isfinite(energy) & (energy != 0.0)
    # What a charger gave is no energy of the trip at whose end the truck was charged.
    charged = known & ((energy < 0.0) | (real.soc_end - real.soc_start > MIN_CHARGE).to_numpy())
    known &= ~charged
    payload = real.payload.dropna()
    km, driven = float(real.distance[known].sum()) / 1000.0, max(real.driving_time.sum(), 1e-9)
    summary: dict[str, Any] = {
        "vehicles": len(dataset.vehicles), "trips": len(table), "trips_driven": len(real),
        "distance_m": float(table.distance.sum()), "driving_time_s": float(table.driving_time.sum()),
        **{f"mean_{k}": float(real[k[:-2]].mean()) if len(real) else None for k in MEANS},
        "mean_speed_m_s": float(real.distance.sum() / driven) if len(real) else None,
        "energy_wh": float(energy[known].sum()) if known.any() else None,
        "energy_wh_per_km": float(energy[known].sum() / km) if km > 0.0 else None,
        "trips_charged": int(charged.sum()),
        "laden_share": float(np.mean(payload > MIN_LOAD_CHANGE)) if len(payload) else None,
    }  # fmt: skip
    means: Any = {f"{of}_mean": (of, "mean") for of in ("distance", "duration", "driving_time", "energy")}
    ways = real.groupby(["from_place", "to_place"], as_index=False).agg(trips=("distance", "size"), **means)
    pairs = ways.sort_values("trips", ascending=False, kind="stable", ignore_index=True)
    per = real.groupby("vehicle_id").distance.sum() / 1000.0
    bars = Bars("distance by vehicle", tuple(map(str, per.index)), per.to_numpy(float), "distance [km]")
    at = real[["x_end", "y_end"]].to_numpy(float)
    ends = Marks("end of a trip", at, ("",) * len(at), np.full(len(at), 0.3))
    tables, lines = {"trips": table, "pairs": pairs}, _lines(summary, pairs, min_distance)
    return Result("trips", summary, tables, {}, [_flows(dataset, real), ends, bars], lines)


def _flows(dataset: Dataset, table: pd.DataFrame) -> Flows:
    """The most frequent trips as arrows between places, or squares of the floor where there is no place."""
    spots = {p.id: (p.x, p.y) for p in dataset.site.places}
    ends = []
    for name, side in (("from_place", "start"), ("to_place", "end")):
        square = np.floor(table[[f"x_{side}", f"y_{side}"]].to_numpy(float) / SQUARE) * SQUARE + 0.5 * SQUARE
        known = np.reshape([spots.get(p, (np.nan, np.nan)) for p in table[name]], (-1, 2))
        ends.append(np.where(np.isfinite(known), known, square))
    way, count = np.unique(np.hstack(ends), axis=0, return_counts=True)
    real = (way[:, :2] != way[:, 2:]).any(axis=1) & np.isfinite(way).all(axis=1)
    most = np.flatnonzero(real)[np.argsort(-count[real], kind="stable")][:MOST_FLOWS]
    weight, pairs = count[most].astype(float), int(real.sum())
    return Flows("trips between places", way[most, :2], way[most, 2:], weight, "trips", pairs)


def _lines(s: dict[str, Any], pairs: pd.DataFrame, shortest: float) -> list[str]:
    n = s["trips"] - s["trips_driven"]
    short = f", {n:,} of them only shunting" if s["trips_driven"] else f", none of {shortest:g} m or more"
    km, hours = s["distance_m"] / 1000.0, s["driving_time_s"] / 3600.0
    out = [SAID("made", **s, short=short if n else "", km=km, hours=hours)]
    if s["mean_distance_m"] is not None:
        out.append(SAID("mean", **s))
    if s["energy_wh"] is not None and s["energy_wh_per_km"] is not None:
        charged = f", without {count(s['trips_charged'], 'trip')} to a charger" if s["trips_charged"] else ""
        kwh, per_km = s["energy_wh"] / 1000.0, s["energy_wh_per_km"] / 1000.0
        out.append(SAID("energy", kwh=kwh, per_km=per_km, left_out=charged))
    known = (r for r in pairs.head(5).to_dict("records") if r["from_place"] and r["to_place"])
    return out + [SAID("pair", pair=pair) for pair in known]


def _places(dataset: Dataset, table: pd.DataFrame, end: str) -> list[str]:
    """Name of the site's place at the start or end of each trip, empty where there is none."""
    spots = np.reshape([(p.x, p.y) for p in dataset.site.places], (-1, 2))
    at = table[[f"x_{end}", f"y_{end}"]].fillna(1e12).to_numpy(float)  # Near no place
    names = [*(p.id for p in dataset.site.places), ""]
    return [names[k] for k in cKDTree(spots).query(at, distance_upper_bound=NEAR)[1]]
