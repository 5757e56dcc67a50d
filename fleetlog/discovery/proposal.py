"""An expression for what no known term explains: a proposal, with its fit, and no more.

A free curve is a sum of hat functions of a recorded variable.  Its columns add up to the energy of its unit, and their mean,
weighted with the knots, is the variable in each window; so shapes with few numbers can be tried on the windows themselves.
The one that predicts held-out trips best is proposed, and how much of the free curve's gain it keeps is said with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery import generic
from fleetlog.discovery.linear import fit
from fleetlog.discovery.residual import Recording
from fleetlog.discovery.select import Choice
from fleetlog.discovery.task import State, Task, posed, selection

Floats = NDArray[np.float64]
Shape = Callable[[Floats, Floats], Floats]
"""Of a variable and of the second one (or zeros), to a number without a dimension."""

SYMBOLS = {
    "speed": ("v", "m/s"), "payload": ("m_load", "kg"), "acceleration": ("a", "m/s2"), "curvature": ("k", "1/m"), "soc": ("SOC", "1"),
    "ambient_temperature": ("T", "degC"), "time": ("h", "h"), "time since start": ("t", "h"), "lift_speed": ("v_lift", "m/s"),
    "fork_height": ("z", "m"),
}  # fmt: skip
UNITS = {"force": ("F", "m g", "1", generic.FORCE), "power": ("P", "", "W", generic.POWER),
         "drive": ("P", "P_drive", "1", generic.DRIVE)}  # fmt: skip
"""Left side, factor on the right, unit of the coefficient, and the unit of a free curve in it."""
STEPS = 13
"""Values of a threshold or a time constant that are tried."""
SIMPLER = 0.97
"""A shape with fewer numbers is kept if it keeps this share of the best one's gain."""


@dataclass(frozen=True)
class Form:
    """A shape: how it is written, how many numbers were fitted in it, its unit, and the function."""

    text: str
    numbers: int
    unit: str
    shape: Shape


def proposed(task: Task, state: State, choice: Choice) -> tuple[str, dict[str, Any]]:
    """What to add to a sentence about a free dependence, and ``proposal`` and ``proposal_fit`` for its evidence."""
    best = propose(task, state, choice)
    if best is None:
        return "", {"proposal": _in_general(choice)}
    c = best["coefficient"]
    said = (
        f"; proposed, and no more: {best['expression']}, c = {c['value']:.3g} {c['unit']} [{c['low']:.3g}, {c['high']:.3g}],"
        f" which keeps {best['kept']:.0%} of what a free curve takes off the error"
    )
    return said, {"proposal": best.pop("expression"), "proposal_fit": best}


def _in_general(choice: Choice) -> str:
    kind, _, variables = choice.candidate.name.partition(" by ")
    state = variables.replace(" and ", ", ") or "standing"
    left, factor, unit, _ = UNITS.get(kind, ("P", "", "W", 1.0))
    return f"{left} = {factor or '1 ' + unit} f({state}), with f dimensionless and piecewise linear"


def propose(task: Task, state: State, choice: Choice) -> dict[str, Any] | None:
    """The best expression for a free curve in the model; None where the curve is no function of recorded numbers.

    Keys: ``expression``, ``coefficient`` with its 95 per cent interval and ``unit``, ``kept``: share of the free curve's
    held-out gain that the expression keeps.
    """
    bench = task.recording
    kind, _, variables = choice.candidate.name.partition(" by ")
    if not isinstance(bench, Recording) or kind not in UNITS:
        return None
    columns = task.free[choice.candidate.name].astype(float)
    place = _means(columns, variables, bench.ranges.knots)
    if place is None:
        return None
    base, x, y = place
    _, p = posed(task, state)
    s = selection(state, p)
    f = fit(p, s, inverse=False)
    root = np.sqrt(p.weight[task.use])
    curve = p.x[:, p.at[choice.candidate.name]] @ f.beta[f.part(s, choice.candidate.name)]
    target = p.y - p.x[:, f.columns] @ f.beta + curve
    known = base[task.use] * root
    x, y, folds = x[task.use], y[task.use], p.fold["trip"]
    nothing = float(target @ target)
    best = nothing - float((target - curve) @ (target - curve))
    some = np.abs(known) > 0.0
    forms = _forms(variables, x[some], y[some])
    tried = [(_gain(known * form.shape(x, y), target, folds), form) for form in forms]
    most = max(gain for gain, _ in tried)
    gain, form = min((t for t in tried if t[0] >= SIMPLER * most), key=lambda t: (t[1].numbers, -t[0]))
    if gain <= 0.0 or best <= 0.0:
        return None
    return _worded(kind, form, known * form.shape(x, y), target, p.trip, min(gain / best, 1.0))


def _means(columns: Floats, variables: str, knots: dict[str, Floats]) -> tuple[Floats, Floats, Floats] | None:
    """(W,) energy of the unit, and (W,) means of the one or two variables there."""
    names = variables.split(" and ")
    if any(n not in knots for n in names):
        return None
    if len(names) == 2:
        grids = [np.linspace(knots[n][0], knots[n][-1], 4) for n in names]
        values = [np.repeat(grids[0], 4), np.tile(grids[1], 4)]
    else:
        values = [
            knots[names[0]]
            if columns.shape[1] == len(knots[names[0]])
            else knots[names[0]][knots[names[0]] != 0.0]
        ]
    if len(values[0]) != columns.shape[1]:
        return None
    base = columns.sum(axis=1)
    means = [columns @ v / np.where(np.abs(base) > 1e-12, base, np.inf) for v in values]
    return base, means[0], means[1] if len(means) == 2 else np.zeros(len(base))


def _forms(variables: str, x: Floats, y: Floats) -> Iterator[Form]:
    names = variables.split(" and ")
    symbol, unit = SYMBOLS.get(names[0], (names[0], "1"))
    low, high = (float(v) for v in np.quantile(x, [0.01, 0.99]))
    inner = np.linspace(low, high, STEPS)[1:-1]
    if len(names) == 2:
        yield from _products(names, x, y)
        return
    yield Form(symbol, 0, unit, lambda x, _: x)
    yield Form(f"{symbol}^2", 0, f"{unit}^2", lambda x, _: x**2)
    for t in inner:
        yield Form(f"max({symbol} - {_short(t)} {unit}, 0)", 1, unit, _above(t))
        yield Form(f"max({_short(t)} {unit} - {symbol}, 0)", 1, unit, _below(t))
        yield Form(f"[{symbol} > {_short(t)} {unit}]", 1, "1", _step(t))
    for a, b in itertools.combinations(inner, 2):
        yield Form(f"[{_short(a)} < {symbol} < {_short(b)} {unit}]", 2, "1", _between(a, b))
    if names[0].startswith("time"):
        for tau in np.geomspace(0.1, 2.0 * (high - low) + 0.1, STEPS):
            yield Form(f"exp(-({symbol} - {_short(low)} h) / {_short(tau)} h)", 1, "1", _decay(low, tau))


def _products(names: list[str], x: Floats, y: Floats) -> Iterator[Form]:
    """Of two variables: products, also of what lies above thresholds."""
    (a, unit_a), (b, unit_b) = (SYMBOLS.get(n, (n, "1")) for n in names)
    yield Form(f"{a} {b}", 0, f"{unit_a} {unit_b}", lambda x, y: x * y)
    yield Form(f"{a} {b}^2", 0, f"{unit_a} ({unit_b})^2", lambda x, y: x * y**2)
    inner = [np.linspace(np.quantile(v, 0.02), np.quantile(v, 0.98), 8)[1:-1] for v in (x, y)]
    for t, u in itertools.product(*inner):
        text = f"[{a} > {_short(t)} {unit_a}] max({b} - {_short(u)} {unit_b}, 0)"
        yield Form(text, 2, unit_b, _corner(t, u))


def _corner(t: float, u: float) -> Shape:
    return lambda x, y: np.where(x > t, np.maximum(y - u, 0.0), 0.0)


def _above(t: float) -> Shape:
    return lambda x, _: np.maximum(x - t, 0.0)


def _below(t: float) -> Shape:
    return lambda x, _: np.maximum(t - x, 0.0)


def _step(t: float) -> Shape:
    return lambda x, _: np.asarray(x > t, dtype=np.float64)


def _between(a: float, b: float) -> Shape:
    return lambda x, _: np.asarray((x > a) & (x < b), dtype=np.float64)


def _decay(start: float, tau: float) -> Shape:
    return lambda x, _: np.exp(-np.maximum(x - start, 0.0) / tau)


def _gain(column: Floats, target: Floats, folds: NDArray[np.int64]) -> float:
    """Sum of squares that a column with one coefficient takes off trips that were held out."""
    xx, xy = np.bincount(folds, column**2), np.bincount(folds, column * target)
    beta = (xy.sum() - xy) / np.maximum(xx.sum() - xx, 1e-300)
    return float((2.0 * beta * xy - beta**2 * xx).sum())


def _worded(
    kind: str, form: Form, column: Floats, target: Floats, trip: NDArray[np.int64], kept: float
) -> dict[str, Any]:
    left, factor, unit, size = UNITS[kind]
    xx = max(float(column @ column), 1e-300)
    beta = float(column @ target) / xx
    scores = np.bincount(trip, column * (target - beta * column))
    error = float(np.sqrt((scores**2).sum())) / xx
    expression = f"{left} = c {factor} {form.text}".replace("  ", " ")
    low, high = sorted((size * (beta - 1.96 * error), size * (beta + 1.96 * error)))
    whole = unit if form.unit == "1" else f"{unit}/({form.unit})"
    coefficient = {"name": "c", "value": size * beta, "low": low, "high": high, "unit": whole}
    return {"expression": expression, "coefficient": coefficient, "kept": kept}


def _short(value: float) -> str:
    return f"{value:.3g}"
