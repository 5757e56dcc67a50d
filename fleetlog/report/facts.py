"""All that a report says of one dataset: results of analyses, and the ledger that figures are summed from.

The ledger has one row a truck and quarter of an hour.  Whatever happened is one column, so figures of the
fleet, of a truck, of a day or of an hour of the day are sums over some of its rows and cannot disagree."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.analysis import utilisation as spent
from fleetlog.analysis.density import density
from fleetlog.analysis.energy import energy
from fleetlog.analysis.heatmap import heatmap
from fleetlog.analysis.near_misses import near_misses
from fleetlog.analysis.occupancy import extent
from fleetlog.analysis.speeding import speeding
from fleetlog.analysis.stops import stops
from fleetlog.analysis.tariff import Tariff, costs
from fleetlog.analysis.trips import trips
from fleetlog.core.arrays import Ints
from fleetlog.core.result import Result
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.listening import progress
from fleetlog.physics.motion.channels import measured_power
from fleetlog.simulate.places import find_stands
from fleetlog.store import Dataset
from fleetlog.store.events import read_table
from fleetlog.store.trips import MIN_LOAD_CHANGE
from fleetlog.view.palette import Scale

SHORTEST_TRIP = 5.0  # A shorter trip is shunting [m]
MOST_CELLS = 400  # Of the heat map, along its longer side
Ledger = pd.DataFrame
KEYS = ["vehicle_id", "start"]  # Of the ledger
UNITS = dict.fromkeys(("km", "energy_km"), 1e3) | dict.fromkeys(("energy_h", "logged_h"), 3600.0)
UNITS |= dict.fromkeys(("energy_tasks", "used_kwh", "charged_kwh"), 1.0)
"""Of consumption, in metres, seconds, tasks and kWh."""


@dataclass
class Facts:
    """One dataset: its ``results`` by name, why others are missing, and the ``ledger``."""

    name: str
    dataset: Dataset
    zone: str
    truck: Truck | None = None
    tariff: Tariff | None = None
    results: dict[str, Result] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)
    ledger: Ledger = field(default_factory=pd.DataFrame)
    energy_from: dict[str, str] = field(default_factory=dict)  # By truck: where its energy comes from
    unseen: list[str] = field(default_factory=list)  # Trucks charged while their log was silent
    left_out: list[str] | None = None  # What the diagnosis says of it, where there was one
    scales: dict[str, Scale] = field(default_factory=dict)  # Of maps that both datasets have

    @property
    def currency(self) -> str:
        """That of the tariff."""
        return self.tariff.currency if self.tariff is not None and self.tariff.currency else "currency"

    def local(self, times: pd.Series) -> pd.Series:
        """Times as the clock on the site's wall shows them."""
        local: pd.Series = times.dt.tz_convert(self.zone).dt.tz_localize(None)
        return local


def gather(facts: Facts) -> Facts:
    """Run every analysis that the dataset can carry, and sum up the ledger."""
    d, truck = facts.dataset, facts.truck
    questions: dict[str, Callable[[], Result]] = {
        "utilisation": lambda: spent.utilisation(d), "trips": lambda: trips(d, min_distance=SHORTEST_TRIP),
        "stops": lambda: stops(d), "heatmap": lambda: heatmap(d, quantity="passages", cell=_cell(d)),
        "density": lambda: density(d), "speeding": lambda: speeding(d), "near_misses": lambda: near_misses(d),
    }  # fmt: skip
    if truck is not None:
        questions["energy"] = lambda: energy(d, truck)
    for number, (name, question) in enumerate(questions.items()):
        progress(f"{facts.name}: {name.replace('_', ' ')}", number / len(questions))
        try:
            facts.results[name] = question()
        except DataError as error:
            facts.missing[name] = error.advice
    facts.ledger = _ledger(facts)
    return facts


def _cell(dataset: Dataset) -> float:
    """Side of the cells of the heat map [m]: 1 in a plant, more on a site of kilometres."""
    x0, y0, x1, y1 = extent(dataset)
    return max(1.0, float(np.ceil(max(x1 - x0, y1 - y0) / MOST_CELLS)))


def _ledger(facts: Facts) -> Ledger:
    """(vehicle_id, start) with one column a sum; :mod:`fleetlog.report.figures` says what is made of them."""
    d, results = facts.dataset, facts.results
    over, near = (results[name].places[name] for name in ("speeding", "near_misses"))
    tasks = tasks_done(d)
    cut = spent.quarters(states := results["utilisation"].tables["states"])
    hours = spent.hours_by_state(cut, cut["vehicle_id"], cut["start"].dt.floor("15min"))
    hours["hours"] = hours.drop(columns="no_data").sum(axis=1)
    hours["moving_h"] = hours[[s for s in spent.STATES if s.startswith("driving")]].sum(axis=1)
    hours = hours.rename(columns={s: f"{s}_h" for s in spent.STATES})
    parts = [hours, _energy(facts, tasks), _summed("tasks", tasks, 1.0)]
    trip = d.trips[d.trips["distance"] >= SHORTEST_TRIP] if len(d.trips) else d.trips
    if len(trip):
        parts.append(_summed("trips", trip, 1.0))
    parts.append(_summed("over_s", over, over["duration"]))
    parts += [_summed("near_misses", near, 0.5, who) for who in ("vehicle_a", "vehicle_b")]
    if "density" in results and len(late := results["density"].tables["tasks"]):
        parts.append(_summed("delay_s", late, late["delay"]))
    out = pd.concat(parts).groupby(level=KEYS).sum()
    # What the data cannot show is no zero.
    if not results["speeding"].summary["limited_s"]:
        out = out.drop(columns="over_s")
    if results["near_misses"].summary["near_misses"] is None:
        out = out.drop(columns="near_misses")
    known = out["energy_h"].groupby(level="vehicle_id").transform("sum") > 0.0
    out.loc[~known, ["used_kwh", "charged_kwh"]] = np.nan
    facts.unseen = [*states.loc[states["charged"] & (states["state"] == "no_data"), "vehicle_id"]]
    # Without a truck file, what rose while the log was silent is a share of an unknown capacity.
    untold = [v for v, source in facts.energy_from.items() if source == "model"]
    untold += facts.unseen if facts.truck is None else []
    out.loc[out.index.isin(untold, level="vehicle_id"), "charged_kwh"] = np.nan
    # A truck without a load channel shows no tasks: it does not count where tasks are counted.
    loads = out.groupby(level="vehicle_id")["driving_h"].transform("sum") == 0.0
    powered = loads & known
    if not loads.any():
        out["tasks"] = np.nan
    out["load_hours"] = out["hours"].where(loads, 0.0)
    out["task_kwh"], out["energy_tasks"] = (out[c].where(powered, 0.0) for c in ("used_kwh", "energy_tasks"))
    if facts.tariff is not None:
        local = facts.local(out.index.get_level_values("start").to_series())
        out["cost"], out["co2_kg"] = costs(out["used_kwh"], out["charged_kwh"], local, facts.tariff)
        out["task_cost"] = out["cost"].where(powered, 0.0)
    return out


def consumption(dataset: Dataset, tasks: pd.DataFrame | None = None, truck: Truck | None = None) -> Ledger:
    """Kilometres, and energy used and charged as the log's electrical channels give it.

    Power is held from each row to the next; a silence longer than ``MAX_GAP`` counts nothing.  What flows
    into the battery while the truck is charged is charged energy, everything else is used (braking returns
    some).  A charge without power is the rise of the state of charge, where ``truck`` gives the capacity.
    ``energy_km``, ``energy_h`` and ``energy_tasks`` are those with a known power, of ``logged_h`` hours."""
    by_truck = () if tasks is None else tasks.groupby("vehicle_id")["start"]
    done = {v: own.dt.as_unit("us").astype("int64").to_numpy() for v, own in by_truck}
    capacity = 0.0 if truck is None else truck.battery.capacity_wh / 1000.0
    of_days = spent.joined_days(dataset, (*spent.COLUMNS, "battery_voltage", "battery_current"))
    days = [_quarters(t, done.get(t.vehicle_id, t.time[:0]), capacity) for t in of_days]
    return pd.concat(days).groupby(level=KEYS).sum().div(pd.Series(UNITS))


def _quarters(t: Trajectory, done: Ints, capacity: float) -> Ledger:
    """One day of a truck, in the ``UNITS``; (n,) times [us] of its tasks, capacity [kWh] of its battery."""
    silent, soc = spent.silences(t), spent.soc_level(t)
    dt = np.where(silent, 0.0, np.diff(t.time, append=t.time[-1:]) * 1e-6)
    watts = measured_power(t)
    known = np.isfinite(watts)
    kwh = np.where(known, watts, 0.0) * dt / 3.6e6
    charging, rise = spent.charging(t), np.nan_to_num(np.diff(soc, append=soc[-1:]))
    given = np.where(silent | ~known, rise * capacity, -kwh)
    metres = np.nan_to_num(t.floats("speed")) * dt
    at = np.searchsorted(t.time, done, side="right") - 1
    tasks = np.bincount(at[at >= 0], minlength=len(t)) * (known & (dt > 0.0))
    energy = np.where(charging, 0.0, kwh), np.where(charging, given, 0.0)
    sums = metres, known * metres, known * dt, dt, tasks, *energy
    rows = pd.DataFrame(dict(zip(UNITS, sums, strict=True)))
    rows["vehicle_id"], rows["start"] = t.vehicle_id, spent.stamps(t.time // spent.QUARTER * spent.QUARTER)
    return rows.groupby(KEYS).sum()


def _energy(facts: Facts, tasks: pd.DataFrame) -> Ledger:
    """Kilometres and energy; without an electrical channel that of the truck's model, if there is one."""
    out = consumption(facts.dataset, tasks, facts.truck)
    hours = out["energy_h"].groupby(level="vehicle_id").sum()
    measured = hours.index[hours > 0.0]
    facts.energy_from, out["measured_h"] = dict.fromkeys(measured, "power"), out["energy_h"]
    if "energy" not in facts.results:
        return out
    model = facts.results["energy"].tables["energy_trips"]
    model = model[~model["vehicle_id"].isin(measured)]
    gauge = model["measured_kwh"]
    used = gauge.fillna(model["energy_kwh"])
    known = gauge.notna().groupby(model["vehicle_id"]).any()
    facts.energy_from |= {str(v): "state of charge" if yes else "model" for v, yes in known.items()}
    out.loc[~out.index.isin(measured, level="vehicle_id"), ["logged_h", "charged_kwh"]] = 0.0
    extra = {"energy_km": model["distance_km"], "energy_h": model["duration_h"], "used_kwh": used,
             "logged_h": model["duration_h"], "charged_kwh": model["charged_kwh"],
             "measured_h": model["duration_h"].where(gauge.notna()),
             "modelled_kwh": model["energy_kwh"].where(gauge.isna())}  # fmt: skip
    theirs = _summed("energy_tasks", tasks[tasks["vehicle_id"].isin(model["vehicle_id"])], 1.0)
    return pd.concat([out, theirs, *(_summed(name, model, values) for name, values in extra.items())])


def tasks_done(dataset: Dataset) -> pd.DataFrame:
    """vehicle_id and start: when each task was done; in a recording, when a load was set down."""
    if (tasks := read_table(dataset, "tasks")) is not None:
        done = tasks[tasks["status"] == "done"]
        return done[["vehicle_id", "dropped"]].rename(columns={"dropped": "start"})
    stands = find_stands(dataset)
    set_down = stands.before - stands.after > MIN_LOAD_CHANGE
    when = pd.to_datetime(stands.start[set_down], unit="us", utc=True)
    names = pd.Series(dataset.vehicles).iloc[stands.vehicle[set_down]].to_numpy()
    return pd.DataFrame({"vehicle_id": names, "start": when})


def _summed(name: str, table: pd.DataFrame, values: Any, vehicle: str = "vehicle_id") -> Ledger:
    """One column of the ledger; values of a time count for its quarter of an hour."""
    start = pd.to_datetime(table["start"], utc=True).dt.as_unit("us").dt.floor("15min")
    keys = [table[vehicle].astype(str).rename("vehicle_id"), start.rename("start")]
    return table.assign(value=values)["value"].astype(float).groupby(keys).sum().to_frame(name)
