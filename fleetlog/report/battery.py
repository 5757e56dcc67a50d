"""State of charge over time and charging by truck."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from fleetlog.core.result import Series
from fleetlog.report.facts import Facts
from fleetlog.store import Dataset

STEP = 60_000_000
"""Of the curves [us]."""
FEW = 8
"""More curves than this are drawn as lowest, median and highest of the fleet."""


@dataclass(frozen=True)
class Charge:
    """``soc`` by minute (rows) and truck (columns), and the curves that are drawn [%]."""

    soc: pd.DataFrame
    shape: Series


def charge_curves(dataset: Dataset) -> Charge | None:
    """The state of charge of every truck by the minute; None where the log has none."""
    columns: dict[str, list[pd.Series]] = {}
    for t in dataset.days(("soc",)):
        known = pd.Series(t.floats("soc"), index=t.time // STEP * STEP).dropna()
        if len(known):
            columns.setdefault(t.vehicle_id, []).append(known.groupby(level=0).last())
    if not columns:
        return None
    soc = pd.DataFrame({name: pd.concat(days) for name, days in columns.items()})
    drawn = soc if len(columns) <= FEW else pd.DataFrame(
        {"lowest": soc.min(axis=1), "median": soc.median(axis=1), "highest": soc.max(axis=1)}
    )  # fmt: skip
    curves = {str(name): 100.0 * drawn[name].to_numpy(float) for name in drawn}
    x = np.asarray(drawn.index, np.int64)
    return Charge(soc, Series("state of charge", x, curves, "time", "state of charge [%]", over_time=True))


def charge_table(facts: Facts, charge: Charge) -> pd.DataFrame:
    """vehicle_id, first, lowest, last (shares), visits to a charger and hours charged."""
    states = facts.results["utilisation"].tables["states"]
    visits = states[states["state"] == "charging"]
    hours = (visits["end"] - visits["start"]).dt.total_seconds().groupby(visits["vehicle_id"]).sum() / 3600.0
    rows = []
    for name in facts.dataset.vehicles:
        known = charge.soc[name].dropna() if name in charge.soc else pd.Series(dtype=float)
        ends = (known.iloc[0], known.min(), known.iloc[-1]) if len(known) else (np.nan,) * 3
        times = int((visits["vehicle_id"] == name).sum())
        rows.append((name, *ends, times, float(hours.get(name, 0.0))))
    return pd.DataFrame(rows, columns=["vehicle_id", "first", "lowest", "last", "visits", "hours"])
