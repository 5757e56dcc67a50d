"""The key figures of one dataset, or of two beside one another with differences and their significance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.core.words import percent
from fleetlog.report.content import Table
from fleetlog.report.facts import Facts
from fleetlog.report.figures import FIGURES, Difference, Figure, compare, holm

SIGNIFICANT = 0.05


@dataclass(frozen=True)
class Row:
    """A figure of each dataset; of two, how the second differs, its p-value corrected for their number."""

    figure: Figure
    unit: str
    values: list[float]
    difference: Difference | None

    @property
    def significant(self) -> bool:
        """Whether the datasets differ by more than chance."""
        return self.difference is not None and self.difference.p_value < SIGNIFICANT


def rows_of(facts: Sequence[Facts]) -> list[Row]:
    """Every figure that one of the datasets has; the unit of money is the tariff's."""
    found: dict[str, Difference] = {}
    if len(facts) == 2:
        a, b = (truck_days(f) for f in facts)
        found = {f.name: d for f in FIGURES if (d := compare(a, b, f)) is not None}
    corrected = dict(zip(found, holm([d.p_value for d in found.values()]), strict=True))
    judged = {name: replace(d, p_value=corrected[name]) for name, d in found.items()}
    tariff = facts[0].tariff
    rows = []
    for figure in FIGURES:
        unit = tariff.currency if figure.money and tariff is not None else figure.unit
        rows.append(Row(figure, unit, [figure.of(f.ledger) for f in facts], judged.get(figure.name)))
    return [row for row in rows if np.isfinite(row.values).any()]


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
    d = row.difference
    if d is None:
        plain = row.values[-1] - row.values[0]
        return [f"{plain:+.3g}" if np.isfinite(plain) else "–", ""]
    if not any(row.values):
        return ["–", ""]
    text = f"{d.difference:+.2g} ({d.low:+.2g} to {d.high:+.2g})"
    return [text, f"significant, p {_p(d.p_value)}" if row.significant else "within chance"]


def changes(rows: list[Row], names: list[str]) -> list[str]:
    """What differs by more than chance, in sentences."""
    out = []
    for row in rows:
        if row.difference is not None and row.significant:
            unit = "" if row.unit.startswith("1/") else row.unit
            a, b = (f"{row.figure.shown(v)} {unit}".rstrip() for v in row.values)
            first, second = row.values
            how = "rose" if second > first else "fell"
            by = f" by {percent(abs(second / first - 1.0))}" if first else ""
            way = f"{how}{by} from {a} in {names[0]} to {b} in {names[1]}"
            out.append(f"{row.figure.label} {way} (p {_p(row.difference.p_value)}).")
    judged = sum(row.difference is not None for row in rows)
    if not judged:
        return ["There are too few truck days to tell differences from chance: each dataset needs four."]
    if not out:
        return [f"None of {judged} figures differs by more than chance."]
    return [*out, f"The other {judged - len(out)} figures that can be judged differ by no more than chance."]


def frame(rows: list[Row], names: list[str]) -> pd.DataFrame:
    """All figures as a table."""
    out = []
    for r in rows:
        row: dict[str, Any] = {"figure": r.figure.name, "label": r.figure.label, "unit": r.unit}
        row |= dict(zip(names, r.values, strict=True))
        if (d := r.difference) is not None:
            row |= {"difference": d.difference, "low": d.low, "high": d.high, "p_value": d.p_value}
        out.append(row)
    return pd.DataFrame(out)


def _p(p: float) -> str:
    return "< 0.01" if p < 0.01 else f"= {p:.2f}"
