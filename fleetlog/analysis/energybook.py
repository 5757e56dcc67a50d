"""Energy of whole trips in books: sums of every term by segment, stretch of road and zone; and as tables."""

import itertools
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.analysis.utilisation import charging, silences, soc_level
from fleetlog.calibrate.fit import UNKNOWNS
from fleetlog.core.arrays import HOUR, Floats, Indices
from fleetlog.core.motion import Motion
from fleetlog.core.network import Network
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.battery import BatteryModel, discharge
from fleetlog.physics.motion import Reconstruction
from fleetlog.physics.motion.channels import measured_power
from fleetlog.physics.motion.rows import gaps
from fleetlog.physics.power import Physics, all_terms, battery_power, cell_power, ledger, term_forces
from fleetlog.store.trips import MAX_GAP

STRETCH = 10.0  # Length of the stretches of road that are told apart [m]
BIN = 60_000_000  # Step of the power ledger over time [us]
Columns = dict[str, Any]
KWH = 3.6e6
SUMS, ENDS, SOURCES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).values()


@dataclass(frozen=True)
class Book:
    """Sums in joules, seconds, metres, as columns of four tables; ``J_TERM`` is the energy of a term.

    segments : a row a trip and hour, in order of time.  Of the sums ``returned`` flowed back into the
        battery; ``traction`` and ``braking`` are drive energy where the wheels push and are pushed;
        ``beside_measured`` is the model where there is a measurement; ``charged`` is what a charger gave
        (no other sum has it); ``raising`` is lifting alone; ``soc_used`` is what the model takes from the
        state of charge, less what was charged; ``soc_after`` of that was charged after the last row.
        ``peak`` is the highest power [W], ``lowest`` the lowest voltage [V] of the model's battery,
        ``source`` what the measured energy of the trip was taken from.
    stretches : a row an edge and ``number`` of the stretch on it.
    zones : a row a zone of the site.
    bins : a row a ``BIN`` of time [us]; ``known`` are the seconds with a measurement."""

    segments: Columns
    stretches: Columns
    zones: Columns
    bins: Columns


def gathered(books: Sequence[Book], what: str) -> pd.DataFrame:
    """One table of all books; a term that one of them lacks is 0 there."""
    table = pd.concat([pd.DataFrame(getattr(book, what)) for book in books], ignore_index=True)
    return table.fillna({name: 0.0 for name in table.columns if name.startswith("J_")})


def keep_book(
    trajectory: Trajectory, found: Reconstruction, physics: Physics, site: Site, battery: BatteryModel
) -> Book:
    """The sums of some trips of one vehicle from the motion ``found`` in them."""
    fine, dt, power = found.motion, found.dt_row, measured_power(trajectory)
    truck, metres, nothing = physics.actual_truck, fine.speed * fine.dt, np.zeros(len(dt))
    time, trip, soc = trajectory.time, trajectory.trip_ids(), soc_level(trajectory)
    # What the measured energy of a trip is taken from: the first that the log has in it.
    begins = np.flatnonzero(np.diff(trip, prepend=trip[:1] - 1))
    has = np.isfinite([trajectory.floats("battery_power"), power, soc, nothing])
    best = np.logical_or.reduceat(has, begins, axis=1).argmax(axis=0)
    source = np.repeat(np.array([*SOURCES])[best], np.diff(np.append(begins, len(trip))))
    full, silent = truck.battery.capacity_wh * 3600.0, np.append(gaps(trajectory.seconds(), MAX_GAP), False)
    gauge = -np.diff(soc, append=soc[-1:]) * full
    # What changes over a silence of the log is no trip's: the model counts nothing there either.
    by_soc, plugged = source == "soc", charging(trajectory)
    taken = np.where(by_soc, np.where(silent, 0.0, gauge), power * dt)
    by_gauge = np.isnan(taken) | silences(trajectory) & np.isfinite(gauge)
    given = np.where(plugged, -np.nan_to_num(np.where(by_gauge, gauge, taken)), 0.0)
    known = np.isfinite(taken) & ~plugged
    forces = term_forces(fine, physics)
    # The charger feeds a truck that is plugged in.
    used = np.where(plugged[found.row], 0.0, fine.dt)
    pieces = {name: watts * used for name, watts in ledger(fine, physics, forces).items()}
    joules = {f"J_{name}": found.rows(piece) for name, piece in pieces.items()}
    work = sum(forces.values(), np.zeros(len(fine))) * metres
    whole = sum(joules.values(), nothing)
    total = np.divide(whole, dt, out=nothing.copy(), where=dt > 0.0)
    loss = (cell_power(total, truck) - total) * dt
    new = np.append(True, (np.diff(trip) != 0) | (np.diff(time // HOUR) != 0))
    starts = np.flatnonzero(new)
    ends = np.append(starts[1:], len(time)) - 1
    beside = np.where(by_soc, whole + loss, whole)
    compared = {"measured": np.where(known, taken, 0.0), "beside_measured": np.where(known, beside, 0.0)}
    sums = {
        "seconds": dt, "metres": found.rows(metres), "kilogram_metres": found.rows(fine.payload * metres),
        "returned": -np.minimum(whole, 0.0),
        "traction": found.rows(np.maximum(work, 0.0)) / truck.drive.efficiency,
        "braking": found.rows(np.minimum(work, 0.0)) * truck.drive.regeneration,
        "loss": loss, "charged": given,
        "raising": np.maximum(joules.get("J_lift_efficiency", nothing), 0.0), **compared,
    }  # fmt: skip
    doubt = found.window_variance(lambda m: battery_power(m, physics), (np.cumsum(new) - 1)[found.row])
    segments = {
        "vehicle_id": trajectory.vehicle_id, "trip_id": trip[starts], "hour": time[starts] // HOUR * HOUR,
        **{n: np.add.reduceat(v, starts) for n, v in (joules | sums).items()}, "motion_variance": doubt,
        "source": source[starts], "peak": np.maximum.reduceat(total, starts),
        "soc_start": soc[starts], "soc_end": soc[ends],
        "start": time[starts], "end": time[ends],
        **_cells(starts, total, dt, soc, trajectory.floats("ambient_temperature"), battery),
        "soc_after": given[ends] / full,
    }  # fmt: skip
    segments["soc_used"] -= segments["charged"] / full
    bins = np.flatnonzero(np.append(True, np.diff(time // BIN) != 0))
    # A gauge steps too coarsely for a curve over time.
    drawn = {n: v * ~by_soc for n, v in (compared | {"known": known * dt}).items()}
    over_time = {n: np.add.reduceat(v, bins) for n, v in (joules | drawn).items()}
    stretches = _by_stretch(fine, sum(pieces.values(), np.zeros(len(fine))), metres)
    inside = [zone.contains(fine.x, fine.y) for zone in site.zones]
    samples = {f"J_{name}": piece for name, piece in pieces.items()} | {"metres": metres, "seconds": fine.dt}
    zones = {name: np.array([row[z].sum() for z in inside]) for name, row in samples.items()}
    zones["zone"] = np.arange(len(inside))
    return Book(segments, stretches, zones, {"time": time[bins] // BIN * BIN, **over_time})


def _by_stretch(motion: Motion, joules: Floats, metres: Floats) -> Columns:
    """Joules and metres on every stretch of directed edge that was driven."""
    on = np.flatnonzero((motion.edge >= 0) & (motion.speed > 0.0))
    number = (np.maximum(motion.edge_offset[on], 0.0) / STRETCH).astype(np.int32)
    columns = {"edge": motion.edge[on], "number": number, "joules": joules[on], "metres": metres[on]}
    rows = pd.DataFrame(columns)
    return {str(n): v.to_numpy() for n, v in rows.groupby(["edge", "number"], as_index=False).sum().items()}


def _cells(
    starts: Indices, power: Floats, dt: Floats, soc: Floats, temperature: Floats, battery: BatteryModel
) -> Columns:
    """Discharge the battery segment by segment, from the (N,) charge in the log, or from full without one."""
    rows = []
    for a, b in itertools.pairwise([*starts.tolist(), len(power)]):
        warm = temperature[a:b][np.isfinite(temperature[a:b])]
        mean = float(warm.mean()) if len(warm) else float("nan")
        start = float(np.nan_to_num(soc[a], nan=1.0))
        done = discharge(power[a:b], dt[a:b], battery, start, mean)
        used = start - done.soc[-1]
        rows.append((used, done.voltage.min(), done.collapsed @ dt[a:b], done.empty @ dt[a:b]))
    names = ("soc_used", "lowest", "collapsed", "empty")
    return dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))


def summed(segments: pd.DataFrame, by: list[str], physics: Physics) -> pd.DataFrame:
    """Segments, a vehicle's in order of time, grouped ``by`` columns, in kWh, km and h.

    A state of charge is that of one vehicle, over a time that no other group interrupts: the model's at the
    end is the log's at the start, less what the model used, plus what was charged meanwhile."""
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
    number = np.arange(len(segments)) + pd.factorize(segments["vehicle_id"])[0]
    spans = segments.assign(number=number).groupby(by, sort=True, dropna=False)["number"]
    socs = total[["soc_start", "soc_end"]].where(spans.max() - spans.min() + 1 == spans.size())
    out = pd.DataFrame({
        "start": start, "end": end, "duration_h": total["seconds"] / 3600.0, "distance_km": km,
        "energy_kwh": energy / KWH, "kwh_per_km": energy / KWH / km.where(km > 0.01),
        "kwh_per_tkm": energy / KWH / tkm.where(tkm > 1e-4),
        "deviation_kwh": np.sqrt(_variance(total, physics) + total["motion_variance"]) / KWH,
        "measured_kwh": measured / KWH,
        "model_beside_measured_kwh": (total["beside_measured"] / KWH).where(known),
        "difference_kwh": (total["beside_measured"] - measured) / KWH, "charged_kwh": total["charged"] / KWH,
        "regenerated_kwh": total["returned"] / KWH, "auxiliary_share": auxiliary / energy.where(energy > 0.0),
        "battery_loss_kwh": total["loss"] / KWH, "peak_power_kw": total["peak"] / 1000.0,
        **socs, "soc_end_model": socs["soc_start"] - total["soc_used"] - total["soc_after"],
        "lowest_voltage_v": total["lowest"], "collapsed_s": total["collapsed"], "empty_s": total["empty"],
    })  # fmt: skip
    ledger = (total[terms] / KWH).rename(columns=lambda c: f"{c.removeprefix('J_')}_kwh")
    return out.join(ledger).reset_index()


def _variance(total: pd.DataFrame, physics: Physics) -> pd.Series:
    """Variance of each row's energy [J2] by the truck's numbers: first-order propagation of their spreads.

    Every sensitivity is a sum that the books hold already.  At the switch from traction to braking the drive
    power is zero, so its move adds nothing to first order, and with E the energy of a group

        dE/d ln(efficiency) = -E_traction  dE/d ln(regeneration) = E_braking  dE/d ln(rolling) = E_rolling"""
    truck = physics.actual_truck
    # Relative standard deviation of each number: from the physics' own interval, else from the prior.
    spread = {u.key: u.deviation(truck) / truck.value(u.key) for u in UNKNOWNS if truck.value(u.key) > 0.0}
    for name, parameters in physics.intervals.items():
        for parameter, (low, high) in parameters.items():
            key = all_terms()[name].by_name[parameter].truck_key
            if key is not None and truck.value(key) > 0.0:
                spread[key] = (high - low) / (2.0 * 1.96) / truck.value(key)
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


def shift_names(hour: pd.Series, starts: Sequence[int]) -> pd.Series:
    """The shift that each hour [us] lies in, as ``06-14``; ``starts`` are hours of the day (UTC), growing."""
    number = np.searchsorted(np.array(starts), ((hour // HOUR) % 24).to_numpy(), side="right") - 1
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
    total = zones.groupby("zone").sum()
    ledger = (total[[f"J_{t}" for t in terms]] / KWH).set_axis([f"{t}_kwh" for t in terms], axis=1)
    energy, km, hours = ledger.sum(axis=1), total["metres"] / 1000.0, total["seconds"] / 3600.0
    table = {"zone": [z.id for z in site.zones], "duration_h": hours, "distance_km": km}
    return pd.DataFrame({**table, "energy_kwh": energy, "kwh_per_km": energy / km.where(km > 0.01), **ledger})
