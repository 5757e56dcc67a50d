"""Curves of an experiment: every run as a dot, the mean of the runs, and its 95 % confidence interval."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import Spread, half_width
from fleetlog.view import palette

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]


def draw_spread(axes: Axes, spread: Spread) -> None:
    """Draw all curves: numbers along the axis, from zero up; names one below the other, close up."""
    number = all(v.replace(".", "", 1).isdigit() for v in spread.values)
    at = np.array([float(v) for v in spread.values]) if number else np.arange(len(spread.values), dtype=float)
    for k, (name, runs) in enumerate(spread.curves.items()):
        # Curves side by side do not hide one another's bars.
        aside = 0.012 * float(np.ptp(at)) * (k - 0.5 * (len(spread.curves) - 1))
        _draw_curve(axes, at + aside, runs, name, palette.dark_colour(k), number)
    axes.set_title(spread.y_label)
    if number:
        axes.set_xticks(at, list(spread.values))
        axes.set_xlabel(spread.x_label)
        axes.set_ylim(bottom=0.0)
    else:
        axes.set_yticks(at, list(spread.values))
        axes.set_ylabel(spread.x_label)
        axes.set_ylim(len(at) - 0.5, -0.5)
    axes.grid(axis="y" if number else "x", color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)
    if any(spread.curves):
        axes.legend()


def _draw_curve(
    axes: Axes, at: Floats, runs: list[Floats], name: str, colour: palette.Share, upright: bool
) -> None:
    known = [k for k, r in enumerate(runs) if len(r)]
    mean = np.array([runs[k].mean() for k in known])
    half = np.nan_to_num([half_width(runs[k]) for k in known])
    for k in known:
        place = np.full(len(runs[k]), at[k])
        axes.plot(*((place, runs[k]) if upright else (runs[k], place)), ".", color=colour, alpha=0.35, ms=4)
    look: dict[str, Any] = dict(color=colour, ms=4, lw=1.2, capsize=3, label=name or None)
    if upright:
        axes.errorbar(at[known], mean, yerr=half, fmt="o-", **look)
    else:
        axes.errorbar(mean, at[known], xerr=half, fmt="o", **look)
