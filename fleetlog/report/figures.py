"""The key figures: each a sum over the ledger, or a ratio of two."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from fleetlog.core.trajectory import Floats
from fleetlog.report.content import number


@dataclass(frozen=True)
class Figure:
    """``factor`` times the sum of a column, over the sum of another one where there is one.

    ``title``: shown large at the head of the page.
    """

    name: str
    label: str
    unit: str
    top: str
    under: str | None = None
    factor: float = 1.0
    title: bool = False

    @property
    def money(self) -> bool:
        """Whether its unit is that of the tariff."""
        return self.name.startswith("cost")

    def shown(self, value: float) -> str:
        """The value as a page shows it."""
        if not np.isfinite(value):
            return "–"
        if self.unit in ("%", "h", "1/h"):
            return f"{value:,.1f}"
        return f"{value:,.2f}" if self.money and abs(value) >= 1.0 else number(value)

    def of(self, ledger: pd.DataFrame) -> float:
        """The figure of some rows of a ledger; NaN where its columns are not known."""
        if self.top not in ledger or (self.under is not None and self.under not in ledger):
            return float("nan")
        under = 1.0 if self.under is None else float(ledger[self.under].sum())
        return self.factor * float(ledger[self.top].sum(min_count=1)) / under if under else float("nan")


FIGURES = (
    Figure("truck_hours", "Truck hours observed", "h", "hours", title=True),
    Figure("driving_share", "Driving", "%", "moving", "hours", 100.0, title=True),
    Figure("laden_share", "Driving with a load", "%", "driving_laden_h", "load_hours", 100.0),
    Figure("empty_share", "Driving empty", "%", "driving_empty_h", "load_hours", 100.0),
    Figure("handling_share", "Handling loads", "%", "handling_h", "load_hours", 100.0),
    Figure("waiting_share", "Waiting", "%", "waiting_h", "load_hours", 100.0, title=True),
    Figure("charging_share", "Charging", "%", "charging_h", "hours", 100.0),
    Figure("idle_share", "Idle", "%", "idle_h", "hours", 100.0),
    Figure("tasks", "Tasks", "", "tasks"),
    Figure("tasks_per_hour", "Tasks per truck hour", "1/h", "tasks", "load_hours", title=True),
    Figure("trips", "Trips", "", "trips"),
    Figure("trips_per_hour", "Trips per truck hour", "1/h", "trips", "hours"),
    Figure("km", "Distance", "km", "km", title=True),
    Figure("km_per_hour", "Distance per truck hour", "km/h", "km", "hours"),
    Figure("speed", "Mean speed while driving", "km/h", "km", "moving"),
    Figure("kwh", "Energy used", "kWh", "used_kwh", title=True),
    Figure("kwh_per_km", "Energy per kilometre", "kWh/km", "used_kwh", "energy_km", title=True),
    Figure("kwh_per_task", "Energy per task", "kWh", "task_kwh", "energy_tasks"),
    Figure("kwh_per_hour", "Energy per truck hour", "kWh/h", "used_kwh", "energy_h"),
    Figure("charged_kwh", "Energy charged", "kWh", "charged_kwh"),
    Figure("cost", "Energy cost", "", "cost", title=True),
    Figure("cost_per_task", "Energy cost per task", "", "task_cost", "energy_tasks"),
    Figure("co2_kg", "CO2", "kg", "co2_kg", title=True),
    Figure("delay", "Delay in congestion per driving hour", "min/h", "delay_s", "moving", 1.0 / 60.0),
    Figure("over_limit", "Driving above the speed limit", "%", "over_s", "moving", 100.0 / 3600.0),
    Figure("near_misses", "Near misses between trucks", "", "near_misses", title=True),
    Figure("near_misses_per_100_km", "Near misses per 100 km", "1/100 km", "near_misses", "km", 100.0),
)
BY_NAME = {f.name: f for f in FIGURES}


@dataclass(frozen=True)
class Difference:
    """Of one figure: b minus a, its 95 % interval, and the p-value of a permutation test."""

    difference: float
    low: float
    high: float
    p_value: float
    units: tuple[int, int]


FEWEST, DRAWS = 4, 2000
"""Fewest units on either side of a statement of significance; permutations, and resamples."""


def compare(a: pd.DataFrame, b: pd.DataFrame, figure: Figure, seed: int = 0) -> Difference | None:
    """Compare a ratio between two tables of truck days, which are exchangeable if nothing has changed.

    None where either lacks it or has fewer than ``FEWEST`` units: a difference then says nothing.
    """
    if figure.under is None or not all({figure.top, figure.under} <= set(t) for t in (a, b)):
        return None
    sums = [t.loc[t[figure.under] > 0.0, [figure.top, figure.under]].to_numpy(float) for t in (a, b)]
    counts = len(sums[0]), len(sums[1])
    if min(counts) < FEWEST:
        return None
    rng = np.random.default_rng(seed)
    pool = np.concatenate(sums)
    first = np.argsort(rng.random((DRAWS, len(pool))), axis=1)[:, : counts[0]]
    one = pool[first].sum(axis=1)
    null = _ratio(pool.sum(axis=0) - one) - _ratio(one)
    seen = float(_ratio(sums[1].sum(axis=0)) - _ratio(sums[0].sum(axis=0)))
    # One truck that alone does something is in either half: differences that nearly reach the one seen count.
    p_value = (1.0 + float((np.abs(null) >= 0.99 * abs(seen)).sum())) / (1.0 + DRAWS)
    drawn = [_ratio(s[rng.integers(0, len(s), (DRAWS, len(s)))].sum(axis=1)) for s in sums]
    low, high = np.quantile(drawn[1] - drawn[0], [0.025, 0.975])
    f = figure.factor
    return Difference(f * seen, f * float(low), f * float(high), p_value, counts)


def _ratio(sums: Floats) -> Floats:
    return np.asarray(sums[..., 0] / np.maximum(sums[..., 1], 1e-300))


def holm(p_values: list[float]) -> list[float]:
    """Return p-values corrected for their number (Holm 1979)."""
    p = pd.Series(p_values, dtype=float).sort_values(kind="stable")
    raised = (p * np.arange(len(p), 0, -1)).cummax().clip(upper=1.0)
    return raised.sort_index().tolist()
