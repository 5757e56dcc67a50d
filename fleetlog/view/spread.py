"""Curves of an experiment: every run as a dot, the mean of the runs, and its 95 % confidence interval."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import Spread, half_width
from fleetlog.view import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]


def draw_spread(axes: Axes, spread: Spread) -> None:
    """Draw all curves; values that are all numbers at their places, others side by side."""
    number = all(v.replace(".", "", 1).isdigit() for v in spread.values)
    at = np.array([float(v) for v in spread.values]) if number else np.arange(len(spread.values), dtype=float)
    for k, (name, runs) in enumerate(spread.curves.items()):
        # Curves side by side do not hide one another's bars.
        aside = 0.012 * float(np.ptp(at)) * (k - 0.5 * (len(spread.curves) - 1))
        _draw_curve(axes, at + aside, runs, name, palette.dark_colour(k), number)
    axes.set_xticks(at, list(spread.values))
    if not number and max(map(len, spread.values)) > 8:
        axes.tick_params(axis="x", labelrotation=30)
    axes.set_title(spread.y_label)
    axes.set_xlabel(spread.x_label)
    axes.set_ylim(bottom=0.0)
    axes.grid(axis="y", color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)
    if any(spread.curves):
        axes.legend()


def _draw_curve(
    axes: Axes, at: Floats, runs: list[Floats], name: str, colour: palette.Share, joined: bool
) -> None:
    known = [k for k, r in enumerate(runs) if len(r)]
    mean = np.array([runs[k].mean() for k in known])
    half = np.array([half_width(runs[k]) for k in known])
    for k in known:
        axes.plot(np.full(len(runs[k]), at[k]), runs[k], ".", color=colour, alpha=0.35, ms=4)
    axes.errorbar(
        at[known], mean, yerr=np.nan_to_num(half), color=colour, fmt="o-" if joined else "o", ms=4, lw=1.2, capsize=3,
        label=name or None,
    )  # fmt: skip
