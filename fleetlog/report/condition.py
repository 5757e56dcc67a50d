"""The sections on the trucks' batteries and on how good the data are."""

import numpy as np
import pandas as pd

from fleetlog.core.result import Series
from fleetlog.core.words import count
from fleetlog.report.content import Part, picture, table
from fleetlog.report.facts import Facts
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP

STEP = 60_000_000  # Of the curves [us]
FEW = 8  # More curves than this are drawn as lowest, median and highest of the fleet
CHARGE = (
    "truck=vehicle_id; at the start=first %; lowest=lowest %; at the end=last %; times charged=visits .0f; "
    "hours charged=hours .2f"
)
DATA = (
    "truck=vehicle_id; rows=rows .0f; interval [s]=interval_s .1f; no data=silent %; on a road=on_road %; "
    "channels=channels"
)
CHANNELS = {
    "speed": "speed", "payload": "load", "fork_height": "forks", "battery_power": "power",
    "soc": "state of charge", "ambient_temperature": "temperature",
}  # fmt: skip


def charge(f: Facts) -> Part:
    """State of charge and charging, by truck."""
    days: dict[str, list[pd.Series]] = {}
    for t in f.dataset.days(("soc",)):
        known = pd.Series(t.floats("soc"), index=t.time // STEP * STEP).dropna()
        if len(known):
            days.setdefault(t.vehicle_id, []).append(known.groupby(level=0).last())
    if not days:
        return Part(["The log has no state of charge."])
    soc = pd.DataFrame({name: pd.concat(own) for name, own in days.items()})
    trucks = _charge_table(f, soc)
    drawn = soc if len(days) <= FEW else pd.DataFrame(
        {"lowest": soc.min(axis=1), "median": soc.median(axis=1), "highest": soc.max(axis=1)}
    )  # fmt: skip
    curves = {str(name): 100.0 * drawn[name].to_numpy(float) for name in drawn}
    x = np.asarray(drawn.index, np.int64)
    course = Series("state of charge", x, curves, "time", "state of charge [%]", over_time=True)
    return Part(
        [f"Lowest state of charge: {100.0 * trucks['lowest'].min():.0f} %."],
        [picture(f, course, "State of charge"), table(trucks, CHARGE, "State of charge by truck")],
    )


def _charge_table(f: Facts, soc: pd.DataFrame) -> pd.DataFrame:
    """vehicle_id, first, lowest, last (shares), visits to a charger and hours charged."""
    states = f.results["utilisation"].tables["states"]
    visits = states[states["state"] == "charging"]
    hours = ((visits["end"] - visits["start"]).dt.total_seconds() / 3600.0).groupby(visits["vehicle_id"])
    ends = {"first": soc.bfill().iloc[0], "lowest": soc.min(), "last": soc.ffill().iloc[-1]}
    known = pd.DataFrame({**ends, "visits": hours.size(), "hours": hours.sum()}).reindex(f.dataset.vehicles)
    return known.fillna({"visits": 0, "hours": 0.0}).reset_index(names="vehicle_id")


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
    return Part(_imported(f.dataset), [table(pd.DataFrame(trucks), DATA, "Data by truck")])


def _imported(dataset: Dataset) -> list[str]:
    """What the import rejected and derived."""
    s = dataset.meta.get("summary") or {}
    if dataset.kind == "simulated":
        return ["The data are simulated: nothing is missing and nothing was rejected."]
    out = [f"{count(dataset.rows, 'row')} of {count(len(s.get('files') or []), 'file')}."]
    for key, what in (("rejected", "row"), ("rejected_values", "value")):
        reasons = s.get(key) or {}
        if reasons:
            why = "; ".join(f"{n:,} {reason}" for reason, n in sorted(reasons.items(), key=lambda i: -i[1]))
            out.append(f"{count(sum(reasons.values()), what)} rejected: {why}.")
    if s.get("matched") is not None:
        out.append(f"{100.0 * float(s['matched']):.1f} % of the rows are on a road.")
    return out
