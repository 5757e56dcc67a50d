"""The key figures: each a sum over the ledger, or a ratio of two; of two datasets beside one another."""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.words import percent
from fleetlog.report.content import Table, number
from fleetlog.report.facts import Facts

FEWEST, DRAWS = 4, 2000  # Fewest units on either side to tell significance; permutations, and resamples


@dataclass(frozen=True)
class Figure:
    """``factor`` times a column's sum, over that of another if any; ``title``: large at the page's head."""

    name: str
    label: str
    unit: str
    top: str
    under: str | None = None
    factor: float = 1.0
    title: bool = False
    whole: bool = False  # Unknown where it is unknown of a truck
    untold: str | None = None  # A column of time of which the log does not say whether it belongs here

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
        over = float(ledger[self.top].sum(min_count=1, skipna=not self.whole))
        return self.factor * over / under if under else float("nan")


_TABLE = tomllib.loads(Path(__file__).with_name("templates").joinpath("figures.toml").read_text("utf-8"))
FIGURES = tuple(Figure(**row) for row in _TABLE["figure"])
BY_NAME = {f.name: f for f in FIGURES}


@dataclass(frozen=True)
class Difference:
    """Of one figure: b minus a, its 95 % interval, and the p-value of a permutation test."""

    difference: float
    low: float
    high: float
    p_value: float
    units: tuple[int, int]

    @property
    def significant(self) -> bool:
        """Whether the datasets differ by more than chance."""
        return self.p_value < 0.05

    @property
    def chance(self) -> str:
        """The p-value in words."""
        return "p < 0.01" if self.p_value < 0.01 else f"p = {self.p_value:.2f}"


def compare(a: pd.DataFrame, b: pd.DataFrame, figure: Figure, seed: int = 0) -> Difference | None:
    """Compare a ratio of two tables of truck days, exchangeable but for their length; None where untold."""
    if figure.under is None or not all({figure.top, figure.under} <= set(t) for t in (a, b)):
        return None
    sums = [t.loc[t[figure.under] > 0.0, [figure.top, figure.under]].to_numpy(float) for t in (a, b)]
    counts = len(sums[0]), len(sums[1])
    if min(counts) < FEWEST or any(t[figure.untold].any() for t in (a, b) if figure.untold in t):
        return None
    rng = np.random.default_rng(seed)
    pool = np.concatenate(sums)
    mixed = np.argsort(rng.random((DRAWS, len(pool))), axis=1)[:, : counts[0]]
    seen, null = (_studentised(pool, units) for units in (np.arange(counts[0])[None], mixed))
    # One truck that alone does something is in either half: differences that nearly reach the one seen count.
    chance = (1.0 + float((null >= 0.99 * seen).sum())) / (1.0 + DRAWS)
    # Of events of a few trucks all halves differ about alike, and that seen may be first by a hair.
    p_value = max(chance, math.erfc(seen[0] / math.sqrt(2.0)))
    drawn = [_ratio(s[rng.integers(0, len(s), (DRAWS, len(s)))].sum(axis=1)) for s in sums]
    low, high = np.quantile(drawn[1] - drawn[0], [0.025, 0.975])
    f, difference = figure.factor, float(_ratio(sums[1].sum(axis=0)) - _ratio(sums[0].sum(axis=0)))
    return Difference(f * difference, f * float(low), f * float(high), p_value, counts)


def _studentised(pool: Floats, units: Ints) -> Floats:
    """(D,) how far the ratio of ``units`` (D, n) is from that of the others, over the difference's error.

    Truck days of unequal length are not exchangeable as they are: a studentised difference keeps its level
    (Janssen 1997, Chung and Romano 2013).  The error is that of no difference: the squares of what each day
    has beyond the common ratio; of a half no less than its share of all, as rare events may all miss it."""
    ratio, n = float(_ratio(pool.sum(axis=0))), len(pool)
    excess = pool[:, 0] - ratio * pool[:, 1]
    each = np.column_stack([excess, pool[:, 1], excess**2 * n / (n - 1)])
    total, one = each.sum(axis=0), each[units].sum(axis=1)
    (d, under, squares), (other, rest, others) = one.T, (total - one).T
    share = total[2] / total[1]
    error = np.maximum(squares / under, share) / under + np.maximum(others / rest, share) / rest
    rounding = (1e-9 * ratio) ** 2 + 1e-300
    return np.asarray(np.abs(d / under - other / rest) / np.sqrt(np.maximum(error, rounding)))


def _ratio(sums: Floats) -> Floats:
    return np.asarray(sums[..., 0] / np.maximum(sums[..., 1], 1e-300))


def holm(p_values: list[float]) -> list[float]:
    """Return p-values corrected for their number (Holm 1979)."""
    p = pd.Series(p_values, dtype=float).sort_values(kind="stable")
    return (p * np.arange(len(p), 0, -1)).cummax().clip(upper=1.0).sort_index().tolist()


@dataclass(frozen=True)
class Row:
    """A figure of each dataset; of two, how the second differs, its p-value corrected for their number."""

    figure: Figure
    unit: str
    values: list[float]
    difference: Difference | None

    def signed(self, value: float) -> str:
        """A difference, to as many decimals as the page shows of the values."""
        digits = max(len(self.figure.shown(v).partition(".")[2]) for v in self.values)
        return f"{round(value, digits) + 0.0:+,.{digits}f}" if np.isfinite(value) else "–"


def rows_of(facts: Sequence[Facts]) -> list[Row]:
    """Every figure that one of the datasets has or a truck lacks; the unit of money is the tariff's."""
    tariff, found = facts[0].tariff, {}
    if len(facts) == 2:
        a, b = (truck_days(f) for f in facts)
        found = {figure: d for figure in FIGURES if (d := compare(a, b, figure)) is not None}
    corrected = zip(found.items(), holm([d.p_value for d in found.values()]), strict=True)
    judged = {figure: replace(d, p_value=p) for (figure, d), p in corrected}
    rows = []
    for figure in FIGURES:
        unit = tariff.currency if figure.money and tariff is not None else figure.unit
        rows.append(Row(figure, unit, [figure.of(f.ledger) for f in facts], judged.get(figure)))
    energy = any(f.energy_from for f in facts)
    return [r for r in rows if np.isfinite(r.values).any() or (energy and r.figure.whole)]


def truck_days(f: Facts) -> pd.DataFrame:
    """The ledger by truck and day: units that are exchangeable if nothing has changed."""
    day = f.local(f.ledger.index.get_level_values("start").to_series()).dt.date.to_numpy()
    return f.ledger.groupby([f.ledger.index.get_level_values("vehicle_id"), day]).sum()


def page_table(rows: list[Row], names: list[str]) -> Table:
    """All figures, with differences where there are two datasets."""
    head, right = ["Figure", "", *names], [False, False, *(True for _ in names)]
    cells = [[r.figure.label, r.unit, *map(r.figure.shown, r.values)] for r in rows]
    if len(names) == 2:
        head, right = [*head, "difference (95 % interval)", ""], [*right, True, False]
        cells = [[*row, *_told(r)] for row, r in zip(cells, rows, strict=True)]
    return Table(head, cells, right)


def _told(row: Row) -> list[str]:
    """The difference, and whether it is more than chance."""
    if (d := row.difference) is None:
        return [row.signed(row.values[-1] - row.values[0]), ""]
    if not any(row.values):
        return ["–", ""]
    text = f"{row.signed(d.difference)} ({row.signed(d.low)} to {row.signed(d.high)})"
    return [text, f"significant, {d.chance}" if d.significant else "within chance"]


def changes(rows: list[Row], names: list[str]) -> list[str]:
    """What differs by more than chance, in sentences."""
    out = []
    for row in rows:
        if row.difference is not None and row.difference.significant:
            unit = "" if row.unit.startswith("1/") else row.unit
            a, b = (f"{row.figure.shown(v)} {unit}".rstrip() for v in row.values)
            first, second = row.values
            how = "rose" if second > first else "fell"
            by = f" by {percent(abs(second / first - 1.0))}" if first else ""
            if unit == "%":
                by = f" by {abs(second - first):.1f} percentage points"
            way = f"{how}{by}, from {a} in {names[0]} to {b} in {names[1]}"
            out.append(f"{row.figure.label} {way} ({row.difference.chance}).")
    if not (judged := sum(row.difference is not None for row in rows)):
        return ["There are too few truck days to tell differences from chance: each dataset needs four."]
    if not out:
        return [f"None of {judged} figures differs by more than chance."]
    return [*out, f"The other {judged - len(out)} figures that can be judged differ by no more than chance."]


def frame(rows: list[Row], names: list[str]) -> pd.DataFrame:
    """All figures as a table."""
    out = []
    for r in rows:
        told = {} if r.difference is None else asdict(r.difference)
        values = dict(zip(names, r.values, strict=True))
        out.append({"figure": r.figure.name, "label": r.figure.label, "unit": r.unit, **values, **told})
    return pd.DataFrame(out).drop(columns="units", errors="ignore")
