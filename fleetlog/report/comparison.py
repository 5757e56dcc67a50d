"""The key figures of one dataset, or of two beside one another with differences and their significance."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.core.words import percent
from fleetlog.report.content import Table
from fleetlog.report.facts import Facts
from fleetlog.report.figures import FIGURES, Difference, Figure, compare, holm

SIGNIFICANT = 0.05


@dataclass
class Comparison:
    """One dataset or two, and what was left out of the truck model of each, in sentences."""

    facts: list[Facts]
    left_out: list[list[str]] = field(default_factory=list)

    @property
    def two(self) -> bool:
        """Whether there are two datasets."""
        return len(self.facts) == 2

    @cached_property
    def figures(self) -> list[tuple[Figure, list[float]]]:
        """Every figure that one of the datasets has."""
        found = [(figure, [figure.of(f.ledger) for f in self.facts]) for figure in FIGURES]
        return [(figure, values) for figure, values in found if np.isfinite(values).any()]

    @cached_property
    def differences(self) -> dict[str, tuple[Difference, float]]:
        """Second minus first by figure, each with its p-value corrected for their number."""
        if not self.two:
            return {}
        a, b = (truck_days(f) for f in self.facts)
        found = {f.name: d for f in FIGURES if (d := compare(a, b, f)) is not None}
        corrected = holm([d.p_value for d in found.values()])
        return {n: (d, p) for (n, d), p in zip(found.items(), corrected, strict=True)}

    def unit(self, figure: Figure) -> str:
        """The unit of a figure; that of money is the tariff's."""
        tariff = self.facts[0].tariff
        return tariff.currency if figure.money and tariff is not None else figure.unit

    def table(self) -> Table:
        """All figures, with differences where there are two datasets."""
        head = ["Figure", "", *(f.name for f in self.facts)]
        rows = [[f.label, self.unit(f), *map(f.shown, values)] for f, values in self.figures]
        if self.two:
            head += ["difference (95 % interval)", ""]
            for row, (figure, values) in zip(rows, self.figures, strict=True):
                row += self._difference(figure.name, values)
        return Table(head, rows, [False, False, True, True, True, False][: len(head)])

    def _difference(self, name: str, values: list[float]) -> list[str]:
        known = self.differences.get(name)
        if known is None:
            plain = values[1] - values[0]
            return [f"{plain:+.3g}" if np.isfinite(plain) else "–", ""]
        d, p = known
        if not any(values):
            return ["–", ""]
        text = f"{d.difference:+.2g} ({d.low:+.2g} to {d.high:+.2g})"
        return [text, f"significant, p {_p(p)}" if p < SIGNIFICANT else "within chance"]

    def changes(self) -> list[str]:
        """What differs by more than chance, in sentences."""
        names = [f.name for f in self.facts]
        out = []
        for figure, values in self.figures:
            known = self.differences.get(figure.name)
            if known is not None and known[1] < SIGNIFICANT:
                unit = "" if self.unit(figure).startswith("1/") else self.unit(figure)
                a, b = (f"{figure.shown(v)} {unit}".rstrip() for v in values)
                how = f"{_by(*values)} from {a} in {names[0]} to {b} in {names[1]}"
                out.append(f"{figure.label} {how} (p {_p(known[1])}).")
        if not self.differences:
            return ["There are too few truck days to tell differences from chance: each dataset needs four."]
        rest = len(self.differences) - len(out)
        if not out:
            return [f"None of {rest} figures differs by more than chance."]
        return [*out, f"The other {rest} figures that can be judged differ by no more than chance."]

    def frame(self) -> pd.DataFrame:
        """All figures as a table."""
        rows = []
        for figure, values in self.figures:
            row: dict[str, Any] = {"figure": figure.name, "label": figure.label, "unit": self.unit(figure)}
            row |= {f.name: v for f, v in zip(self.facts, values, strict=True)}
            if figure.name in self.differences:
                d, p = self.differences[figure.name]
                row |= {"difference": d.difference, "low": d.low, "high": d.high, "p_value": p}
            rows.append(row)
        return pd.DataFrame(rows)


def truck_days(f: Facts) -> pd.DataFrame:
    """The ledger by truck and day: units that are exchangeable if nothing has changed."""
    day = f.local(f.ledger.index.get_level_values("start").to_series()).dt.date.to_numpy()
    return f.ledger.groupby([f.ledger.index.get_level_values("vehicle_id"), day]).sum()


def _by(first: float, second: float) -> str:
    """How far a figure rose or fell."""
    word = "rose" if second > first else "fell"
    return f"{word} by {percent(abs(second / first - 1.0))}" if first else word


def _p(p: float) -> str:
    return "< 0.01" if p < 0.01 else f"= {p:.2f}"
