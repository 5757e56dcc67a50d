"""The books as tables: by trip, vehicle, shift, hour, stretch of road and zone; how sure their energy is."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from fleetlog.analysis.energybook.book import HOUR, STRETCH
from fleetlog.calibrate.parameters import UNKNOWNS
from fleetlog.core.network import Network
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.physics.power import Physics, all_terms

KWH = 3.6e6
SUMS = (
    "seconds", "metres", "kilogram_metres", "returned", "traction", "braking", "loss", "measured",
    "beside_measured", "raising", "motion_variance", "collapsed", "empty",
)  # fmt: skip
ENDS = {
    "peak": "max", "lowest": "min", "start": "min", "end": "max", "soc_start": "first", "soc_end": "last",
    "soc_end_model": "last",
}  # fmt: skip
"""Of several segments: which value is theirs."""


def with_soc(segments: pd.DataFrame, truck: Truck) -> pd.DataFrame:
    """Take measured energy from the state of charge where the log has nothing else: change times capacity.

    It is that of a whole trip, put into its last segment; within a trip the gauge's steps say nothing.
    """
    only_soc = segments["source"] == "soc"
    if not only_soc.any():
        return segments
    segments = segments.copy()
    keys = ["vehicle_id", "trip_id"]
    trips = segments[only_soc].groupby(keys, sort=False)
    used = (trips["soc_start"].first() - trips["soc_end"].last()) * truck.battery.capacity_wh * 3600.0
    last = segments[only_soc].drop_duplicates(keys, keep="last").index
    of_trip = pd.MultiIndex.from_frame(segments.loc[last, keys])
    segments.loc[last, "measured"] = used.reindex(of_trip).to_numpy()
    total = segments.filter(like="J_").sum(axis=1) + segments["loss"]
    segments.loc[only_soc, "beside_measured"] = total[only_soc]
    return segments


def summed(segments: pd.DataFrame, by: list[str], physics: Physics) -> pd.DataFrame:
    """Segments grouped ``by`` columns, in kWh, km and h."""
    add = [c for c in segments.columns if c.startswith("J_") or c in SUMS]
    grouped = segments.groupby(by, sort=True, dropna=False)
    total = grouped[add].sum().join(grouped.agg(ENDS))
    terms = [c for c in total.columns if c.startswith("J_")]
    energy = total[terms].sum(axis=1)
    km, tkm = total["metres"] / 1000.0, total["kilogram_metres"] / 1e6
    known = total["beside_measured"] != 0.0
    measured = total["measured"].where(known)
    auxiliary = total.get("J_auxiliary_load", 0.0) + total.get("J_thermal_load", 0.0)
    start, end = (pd.to_datetime(total[name], unit="us", utc=True) for name in ("start", "end"))
    out = pd.DataFrame({
        "start": start, "end": end, "duration_h": total["seconds"] / 3600.0, "distance_km": km,
        "energy_kwh": energy / KWH,
        "kwh_per_km": energy / KWH / km.where(km > 0.01), "kwh_per_tkm": energy / KWH / tkm.where(tkm > 1e-4),
        "deviation_kwh": np.sqrt(_variance(total, physics) + total["motion_variance"]) / KWH,
        "measured_kwh": measured / KWH,
        "model_beside_measured_kwh": (total["beside_measured"] / KWH).where(known),
        "difference_kwh": (total["beside_measured"] - measured) / KWH,
        "regenerated_kwh": total["returned"] / KWH, "auxiliary_share": auxiliary / energy.where(energy > 0.0),
        "battery_loss_kwh": total["loss"] / KWH, "peak_power_kw": total["peak"] / 1000.0,
        "soc_start": total["soc_start"], "soc_end": total["soc_end"], "soc_end_model": total["soc_end_model"],
        "lowest_voltage_v": total["lowest"], "collapsed_s": total["collapsed"], "empty_s": total["empty"],
    })  # fmt: skip
    ledger = (total[terms] / KWH).rename(columns=lambda c: f"{c.removeprefix('J_')}_kwh")
    return out.join(ledger).reset_index()


def _variance(total: pd.DataFrame, physics: Physics) -> pd.Series:
    """Variance of each row's energy [J2] by the truck's numbers: first-order propagation of their spreads.

    Every sensitivity is a sum that the books hold already.  At the switch from traction to braking the drive
    power is zero, so its move adds nothing to first order, and with E the energy of a group

        dE/d ln(efficiency) = -E_traction    dE/d ln(regeneration) = E_braking    dE/d ln(rolling) = E_rolling
    """
    truck = physics.actual_truck
    spread = relative_spreads(truck, physics)
    none, raising = pd.Series(0.0, index=total.index), total["raising"]
    load = total["kilogram_metres"] / total["metres"].where(total["metres"] > 0.0)
    carriage = truck.lift.carriage_mass
    slopes = {
        "drive.efficiency": -total["traction"], "drive.regeneration": total["braking"],
        "resistance.rolling": total.get("J_rolling_resistance", none),
        "resistance.drag_area": total.get("J_aerodynamic_drag", none), "lift.efficiency": -raising,
        "lift.recuperation": total.get("J_lift_efficiency", none) - raising,
        "auxiliary.power": total.get("J_auxiliary_load", none),
        "lift.carriage_mass": raising * (carriage / (carriage + load.fillna(0.0) + 1e-9)),
    }  # fmt: skip
    parts = [np.square(slope * spread.get(key, 0.0)) for key, slope in slopes.items()]
    return pd.Series(np.sum(parts, axis=0), index=total.index)


def relative_spreads(truck: Truck, physics: Physics) -> dict[str, float]:
    """Relative standard deviation of each number: from the physics' own interval, else from the prior."""
    spreads = {u.key: u.deviation(truck) / truck.value(u.key) for u in UNKNOWNS if truck.value(u.key) > 0.0}
    for name, parameters in physics.intervals.items():
        for parameter, (low, high) in parameters.items():
            key = all_terms()[name].by_name[parameter].truck_key
            if key is not None and truck.value(key) > 0.0:
                spreads[key] = (high - low) / (2.0 * 1.96) / truck.value(key)
    return spreads


def shift_names(hour: pd.Series, starts: Sequence[int]) -> pd.Series:
    """The shift that each hour [us] lies in, as ``06-14``; ``starts`` are hours of the day (UTC), growing."""
    of_day = (hour // HOUR) % 24
    number = np.searchsorted(np.array(starts), of_day.to_numpy(), side="right") - 1
    names = [f"{s:02d}-{e:02d}" for s, e in zip(starts, [*starts[1:], starts[0]], strict=True)]
    return pd.Series([names[k] for k in number], index=hour.index)


def stretch_table(stretches: pd.DataFrame, network: Network | None) -> pd.DataFrame:
    """Joules, metres and energy per metre of every stretch of directed edge that was driven."""
    if network is None:
        return pd.DataFrame()
    table = stretches.groupby(["edge", "number"], as_index=False).sum()
    table["from"] = table["number"] * STRETCH
    table["to"] = np.minimum(table["from"] + STRETCH, network.length[table["edge"]])
    table["joules_per_metre"] = table["joules"] / table["metres"]
    middle = ((table["from"] + table["to"]) / 2.0).to_numpy()
    table[["x", "y"]] = network.position(table["edge"].to_numpy(np.int32), middle)[:, :2]
    table.insert(0, "edge_id", [network.edge_ids[e] for e in table["edge"]])
    return table[table["to"] > table["from"]].drop(columns="number").reset_index(drop=True)


def zone_table(zones: pd.DataFrame, terms: Sequence[str], site: Site) -> pd.DataFrame:
    """Energy by zone of the site, with the ledger."""
    if not site.zones:
        return pd.DataFrame()
    names = [f"J_{t}" for t in terms]
    total = {n: np.bincount(zones["zone"], zones[n], len(site.zones)) for n in (*names, "metres", "seconds")}
    energy, km = np.stack([total[n] for n in names], axis=1).sum(axis=1) / KWH, total["metres"] / 1000.0
    table = {"zone": [z.id for z in site.zones], "duration_h": total["seconds"] / 3600.0, "distance_km": km}
    table |= {"energy_kwh": energy, "kwh_per_km": energy / np.where(km > 0.01, km, np.nan)}
    return pd.DataFrame(table | {f"{t}_kwh": total[f"J_{t}"] / KWH for t in terms})
