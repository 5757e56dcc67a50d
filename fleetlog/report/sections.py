"""The sections of a fleet report, each a function of the facts of one dataset."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import pandas as pd

from fleetlog.analysis.apart import remark
from fleetlog.analysis.utilisation import STATES, state_bars
from fleetlog.core.result import Bars, EdgeValues, Grid, Marks, Result, Series
from fleetlog.core.words import Sentences, count, listed, reasons
from fleetlog.physics.power import cause
from fleetlog.report.content import TABLES, Part, number, picture, table
from fleetlog.report.facts import Facts
from fleetlog.report.figures import BY_NAME
from fleetlog.simulate.limits import told_limits
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP

S = TypeVar("S", Bars, Grid, EdgeValues)
ENERGY_SUMS = ("used_kwh", "charged_kwh", "energy_km", "energy_h", "measured_h", "logged_h", "cost", "co2_kg")
SAID = Sentences(__file__)
STEP = 60_000_000  # Of the curves [us]
SLIVER = 0.01  # Of the fullest hour: what begins with the last row of a log is no hour
FEW = 8  # More curves than this are drawn as lowest, median and highest of the fleet
CHANNELS = TABLES["channels"]


def shapes(facts: Facts, name: str, kind: type[S]) -> list[S]:
    """The shapes of one kind of a result; none where the analysis could not be made."""
    result = facts.results.get(name)
    return [] if result is None else [s for s in result.shapes if isinstance(s, kind)]


def utilisation_part(f: Facts) -> Part:
    """What the trucks do, by truck and by hour of the day."""
    hours = f.ledger[[f"{s}_h" for s in STATES]].set_axis(STATES, axis=1)
    by_truck = hours.groupby(level="vehicle_id").sum()
    of_day = f.local(hours.index.get_level_values("start").to_series()).dt.strftime("%H:00").to_numpy()
    by_hour = hours.groupby(of_day).sum()
    logged = by_hour.drop(columns="no_data").sum(axis=1)
    by_hour = by_hour[logged > SLIVER * logged.max()]
    blocks = [picture(f, state_bars("by truck", by_truck), "What each truck does")]
    if len(by_hour) > 1:
        bars = state_bars("by hour of the day", by_hour)
        blocks.append(picture(f, bars, "What the fleet does, by hour of the day"))
    known = by_truck.drop(columns="no_data")
    total = known.sum(axis=1)
    share = known.div(total.clip(lower=1e-9), axis=0).assign(hours=total).reset_index()
    seen = [f"{s.replace('_', ' ')}={s} %" for s in map(str, known) if (known[s] > 0.0).any()]
    columns = "\n".join(["truck=vehicle_id", "hours=hours .2f", *seen])
    part = Part([], [*blocks, table(share, columns, "Share of the time by truck")])
    if unknown := share.loc[share["driving"] > 0.0, "vehicle_id"].tolist():
        part.lines.append(SAID("no_load", trucks=listed(unknown)))
    return part


def work(f: Facts) -> Part:
    """Tasks, trips and distance, by truck and by hour; the most frequent relations."""
    keep = [c for c in ("tasks", "trips", "km", "hours", "load_hours") if c in f.ledger]
    trucks = f.ledger[keep].groupby(level="vehicle_id").sum().reset_index()
    trucks["tasks"] = trucks["tasks"].where(trucks["load_hours"] > 0.0)
    for name in ("tasks", "trips", "km"):
        if name in trucks:
            trucks[f"{name}/h"] = trucks[name] / trucks["hours"].where(trucks["hours"] > 0.0)
    part = Part([], [table(trucks, "work", "Work by truck")])
    start = f.ledger.index.get_level_values("start").to_series()
    hours = f.ledger[["tasks", "hours"]].groupby(start.dt.floor("h").to_numpy()).sum(min_count=1)
    hourly = hours.loc[hours["hours"] > SLIVER * hours["hours"].max(), "tasks"]
    if len(hourly) > 1 and hourly.notna().any():
        # An hour of nothing ends every shift: no curve runs on through the night.
        hourly = hourly.reindex(hourly.index.union(hourly.index + pd.Timedelta("1h")))
        x, y = pd.DatetimeIndex(hourly.index).as_unit("us").asi8, {"tasks": hourly.to_numpy(float)}
        curve = Series("tasks", x, y, "time", "tasks per hour", over_time=True, counts=True)
        part.blocks.append(picture(f, curve, "Tasks done in each hour"))
    if "trips" in f.results:
        pairs = f.results["trips"].tables["pairs"]
        if len(named := pairs[(pairs["from_place"] != "") & (pairs["to_place"] != "")]):
            part.blocks.append(table(named, "flows", "Most frequent trips between places", most=10))
    return part


def energy_part(f: Facts) -> Part:
    """Energy, cost and CO2 by truck, and by cause where a truck file is given."""
    keep = [c for c in ENERGY_SUMS if c in f.ledger]
    trucks = f.ledger[keep].groupby(level="vehicle_id").sum(min_count=1).reset_index()
    known = trucks["energy_h"] > 0.0
    trucks["per_km"] = trucks["used_kwh"] / trucks["energy_km"].where(trucks["energy_km"] > 0.01)
    trucks["known"] = trucks["measured_h"] / trucks["logged_h"].where(trucks["logged_h"] > 0.0)
    trucks["source"] = [f.energy_from.get(v, "unknown") for v in trucks["vehicle_id"]]
    money = f" (cost in {f.currency})" if "cost" in trucks else ""
    part = Part([], [table(trucks, "energy", f"Energy by truck{money}")])
    if not known.all():
        part.lines.append(SAID("no_power", trucks=listed(trucks.loc[~known, "vehicle_id"].tolist())))
    if "energy" in f.results:
        s = f.results["energy"].summary
        causes = sorted(((k, v) for k, v in s["ledger_kwh"].items() if v), key=lambda i: -abs(i[1]))
        said = ", ".join(f"{cause(k)} {v:.2f} kWh" for k, v in causes[:4])
        part.lines.append(SAID("model", **s, causes=said))
        measured, model = s["measured_kwh"], s["model_beside_measured_kwh"]
        if measured > 0.0:
            more = f"{100.0 * abs(model / measured - 1.0):.1f} % {'more' if model > measured else 'less'}"
            part.lines.append(f"Where energy was measured, the model gives {more}.")
        pictures: dict[str, Sequence[Bars | EdgeValues]] = {
            "Energy of the model by cause, all trucks": shapes(f, "energy", Bars),
            "Energy per kilometre, by direction of the road": shapes(f, "energy", EdgeValues),
        }
        part.blocks += [picture(f, drawn, what) for what, found in pictures.items() for drawn in found]
    return part


def limits(f: Facts) -> Part:
    """What limits a simulated fleet, and what one more of it brings; empty where the dataset does not say."""
    if not (told := (f.dataset.meta.get("summary") or {}).get("limits")):
        return Part()
    lines = [told_limits(told), told["one_more"].get("statement", "")]
    waits = listed([f"{s / 3600.0:.2f} h for {kind}" for kind, s in told["waiting_s"].items()])
    found = pd.DataFrame(told["resources"]).fillna({"name": "–"})
    shown = table(found, "limits", f"How busy everything is; trucks wait {waits}")
    return Part([f"{line[0].upper()}{line[1:]}." for line in lines if line], [shown])


def places(f: Facts) -> Part:
    """Where the trucks are: busiest places, passages over the floor."""
    part = Part()
    if (result := f.results.get("stops")) is not None:
        busiest = result.places["places"].sort_values("dwell_total", ascending=False, kind="stable")
        busiest = busiest.assign(hours=busiest["dwell_total"] / 3600.0)
        if len(busiest):
            part.blocks.append(table(busiest, "busy", "Busiest places", most=10))
            part.blocks.append(picture(f, None, "Places where trucks stop; the larger, the longer", result))
        else:
            part.lines.append("No place was visited three times or more.")
    for grid in shapes(f, "heatmap", Grid)[:1]:
        part.lines += remark("Passages", f.results["heatmap"].summary["left_out_share"])
        part.blocks.append(picture(f, grid, "How often trucks pass"))
    return part


def congestion(f: Facts) -> Part:
    """Delay by others, and where."""
    if "density" not in f.results:
        return Part([f"Congestion is not known: {f.missing.get('density', '')}."])
    result = f.results["density"]
    s, areas = result.summary, result.places.get("areas")
    said, n = remark("Congestion", s["left_out_share"]), s["episodes"]
    if n is not None:
        said.insert(0, f"{count(n, 'episode')} of congestion, {number(s['delay_s'])} s of delay in all.")
    part = Part(said)
    if areas is not None:
        part.blocks.append(table(areas, "areas", "Where trucks lose most time", most=8))
        marks = [m for m in result.shapes if isinstance(m, Marks)]
        caption = "Delay in congestion; rings: the areas with most of it"
        for layer in shapes(f, "density", EdgeValues):
            part.blocks.append(picture(f, layer, caption, Result("density", {}, shapes=[layer, *marks])))
    return part


def safety(f: Facts) -> Part:
    """Speeding and near misses."""
    part = Part()
    near, over = (f.results[name].places[name] for name in ("near_misses", "speeding"))
    near = near.assign(worst=near[["ttc_s", "pet_s"]].min(axis=1)).sort_values("worst")
    words = " (TTC: time to collision, PET: post-encroachment time)"
    for name, found, caption, key, heads in (
        ("near_misses", near, "Near misses, the closest first", words, "near"),
        ("speeding", over, "Longest drives above the limit", "", "over"),
    ):
        part.lines += f.results[name].lines
        if len(found):
            rows = table(found.assign(start=f.local(found["start"])), heads, caption + key, most=10)
            part.blocks += [rows, picture(f, None, f"{caption}: where", f.results[name])]
    return part


def charge(f: Facts) -> Part:
    """State of charge and charging, by truck."""
    days: dict[str, list[pd.Series]] = {}
    for t in f.dataset.days(("soc",)):
        if len(known := pd.Series(t.floats("soc"), index=t.time // STEP * STEP).dropna()):
            days.setdefault(t.vehicle_id, []).append(known.groupby(level=0).last())
    if not days:
        return Part(["The log has no state of charge."])
    soc = pd.DataFrame({name: pd.concat(own) for name, own in days.items()})
    states = f.results["utilisation"].tables["states"].sort_values(["vehicle_id", "start"], kind="stable")
    begins = states["charged"] & ~states.groupby("vehicle_id")["charged"].shift(fill_value=False)
    visits, hours = begins.groupby(states["vehicle_id"]).sum(), f.ledger["charging_h"].groupby("vehicle_id")
    ends = {"first": soc.bfill().iloc[0], "lowest": soc.min(), "last": soc.ffill().iloc[-1]}
    trucks = pd.DataFrame({**ends, "visits": visits, "hours": hours.sum()}).reindex(f.dataset.vehicles)
    trucks = trucks.fillna({"visits": 0, "hours": 0.0}).reset_index(names="vehicle_id")
    trucks.loc[trucks["vehicle_id"].isin(f.unseen), "hours"] = np.nan
    trucks.loc[trucks["lowest"].isna() & (trucks["visits"] == 0), ["visits", "hours"]] = np.nan
    fleet = {"lowest": soc.min(axis=1), "median": soc.median(axis=1), "highest": soc.max(axis=1)}
    drawn = soc if len(days) <= FEW else pd.DataFrame(fleet)
    curves = {str(name): 100.0 * drawn[name].to_numpy(float) for name in drawn}
    x = np.asarray(drawn.index, np.int64)
    course = Series("state of charge", x, curves, "time", "state of charge [%]", over_time=True)
    return Part(
        [f"Lowest state of charge: {100.0 * trucks['lowest'].min():.0f} %."],
        [picture(f, course, "State of charge"), table(trucks, "charge", "State of charge by truck")],
    )


def data_quality(f: Facts) -> Part:
    """How good the data of every truck are."""
    days = pd.DataFrame([
        {
            "vehicle_id": t.vehicle_id, "rows": len(t), "steps": np.diff(t.time) * 1e-6,
            "road": (t.labels("edge_id").codes >= 0).sum(), "channels": {c for c in CHANNELS if t.has(c)},
        }
        for t in f.dataset.days((*CHANNELS, "edge_id"))
    ])  # fmt: skip
    trucks = []
    for name, own in days.groupby("vehicle_id", sort=False):
        steps, has = np.concatenate(own["steps"].tolist()), set.union(*own["channels"])
        trucks.append({
            "vehicle_id": name, "rows": own["rows"].sum(), "on_road": own["road"].sum() / own["rows"].sum(),
            "interval_s": np.median(steps) if len(steps) else np.nan,
            "silent": steps[steps > MAX_GAP].sum() / max(steps.sum(), 1e-9),
            "channels": ", ".join(word for c, word in CHANNELS.items() if c in has) or "position only",
        })  # fmt: skip
    return Part(_imported(f.dataset), [table(pd.DataFrame(trucks), "data", "Data by truck")])


def _imported(dataset: Dataset) -> list[str]:
    """What the import rejected and derived."""
    s = dataset.meta.get("summary") or {}
    if dataset.kind == "simulated":
        return ["The data are simulated: nothing is missing and nothing was rejected."]
    out = [f"{count(dataset.rows, 'row')} of {count(len(s.get('files') or []), 'file')}."]
    rejected = ((s.get("rejected"), "row"), (s.get("rejected_values"), "value"))
    out += [f"{count(sum(why.values()), what)} rejected ({reasons(why)})." for why, what in rejected if why]
    if s.get("matched") is not None:
        out.append(f"{100.0 * float(s['matched']):.1f} % of the rows are on a road.")
    return out


SECTIONS: dict[str, Callable[[Facts], Part]] = {
    "Utilisation": utilisation_part, "Work": work, "What limits the fleet": limits, "Energy": energy_part,
    "State of charge": charge, "Places": places, "Congestion": congestion, "Safety": safety,
    "Data quality": data_quality,
}  # fmt: skip


def answers(f: Facts) -> list[str]:
    """The report in a few sentences."""
    values = {name: figure.of(f.ledger) for name, figure in BY_NAME.items()}

    def of(name: str) -> str:
        return BY_NAME[name].shown(values[name])

    doing = {"driving": "drove", "handling": "handled loads", "waiting": "waited",
             "standing": "handled or waited (the log does not tell which)", "charging": "charged",
             "idle": "idled"}  # fmt: skip
    known = {verb: values[f"{name}_share"] for name, verb in doing.items()}
    said = [f"{verb} {v:.0f} %" for verb, v in known.items() if v >= 0.5]
    trucks = count(len(f.dataset.vehicles), "truck")
    out = [f"In {of('truck_hours')} truck hours, {trucks} {listed(said) or 'did nothing'} of the time."]
    if values["tasks"] > 0.0:
        partly = f.ledger["load_hours"].sum() < 0.999 * f.ledger["hours"].sum()
        per = f"{of('tasks_per_hour')} per truck hour{' of those that log loads' * bool(partly)}"
        out.append(f"The fleet did {of('tasks')} tasks, {per}, and drove {of('km')} km.")
    if values["kwh"] > 0.0:
        k, n = len(f.energy_from), len(f.dataset.vehicles)
        who = "The fleet" if k == n else f"{k} of {trucks} (the energy of the others is unknown)"
        covered = 100.0 * f.ledger["energy_h"].sum() / f.ledger["logged_h"].sum()
        share = f" in the {covered:.1f} % of the time for which energy is known" if covered < 99.95 else ""
        share += f" ({of('modelled_kwh')} kWh of it modelled, not measured)" * (values["modelled_kwh"] > 0.0)
        out.append(f"{who} used {of('kwh')} kWh{share}, {of('kwh_per_km')} kWh per kilometre.")
        told = {"cost": f"cost {of('cost')} {f.currency}", "co2_kg": f"emitted {of('co2_kg')} kg of CO2"}
        if any(values[name] > 0.0 for name in told):
            out.append(f"That {listed([said for name, said in told.items() if values[name] > 0.0])}.")
    if "density" in f.results and "areas" in f.results["density"].places:
        first = f.results["density"].places["areas"].iloc[0]
        out.append(f"Most time is lost to congestion on {first['roads']}: {number(first['delay'])} s.")
    return out + limits(f).lines + f.results["near_misses"].lines + f.results["speeding"].lines


def local_span(f: Facts) -> str:
    """First and last time of a dataset in the site's hours."""
    # Rounded while they are UTC: in autumn the wall has an hour twice.
    times = (pd.Timestamp(f.dataset.meta[k]).round("min") for k in ("start", "end"))
    start, end = (time.tz_convert(f.zone) for time in times)
    last = f"{end:%H:%M}" if start.date() == end.date() else f"{end:%d %b %Y %H:%M}"
    return f"{start:%d %b %Y %H:%M} to {last} ({f.zone.replace('_', ' ')})"
