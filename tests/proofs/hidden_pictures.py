"""Pictures of docs/proof.md: slope found against altitude withheld, resistance found against surface withheld."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.discovery.diagnose import Diagnosis
from fleetlog.view.picture import DPI, STYLE
from tests.proofs.hidden_judges import Class, Profile, by_altitude, classes, profiles
from tests.proofs.public_logs import Log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RECORDED, FOUND, NOTE = "#33373d", "#1d6fb8", "#5a5f66"


def draw(name: str, d: Diagnosis, log: Log, path: Path) -> None:
    """One PNG; nothing where nothing was found."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE | {"font.size": 10.0, "legend.fontsize": 9.5}):
        found = classes(d, log) if log.labels else profiles(d, log)
        if not found:
            return
        figure = Figure(figsize=(10.0, 4.4 if log.labels else 5.6), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        if log.labels:
            _surfaces(figure, [c for c in found if isinstance(c, Class)])
        else:
            _slopes(figure, name, [p for p in found if isinstance(p, Profile)])
        figure.savefig(path, dpi=DPI, facecolor="white", metadata={"Software": "fleetlog"})


def _slopes(figure: Figure, name: str, runs: list[Profile]) -> None:
    """Altitude and both slopes along the longest run, and all pieces against one another."""
    p = max(runs, key=lambda r: r.distance[-1])
    agreement = by_altitude(runs)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.3, 1.0], height_ratios=[1.0, 1.9])
    top = figure.add_subplot(grid[0, 0])
    top.fill_between(p.distance / 1e3, p.altitude, p.altitude.min() - 10.0, color="#d9dee5", lw=0)
    top.plot(p.distance / 1e3, p.altitude, color=RECORDED, lw=1.2)
    top.set_ylabel("altitude [m]")
    top.set_title("Withheld: recorded altitude", color=RECORDED)
    top.set_ylim(p.altitude.min() - 10.0, None)
    low = figure.add_subplot(grid[1, 0], sharex=top)
    band = 196.0 * p.error
    low.axhline(0.0, color="#c4cad2", lw=0.8)
    low.fill_between(
        p.middle / 1e3, 100.0 * p.found - band, 100.0 * p.found + band, color=FOUND, alpha=0.18, lw=0
    )
    low.plot(p.middle / 1e3, 100.0 * p.recorded, color=RECORDED, lw=1.3, label="recorded, from the altitude")
    low.plot(
        p.middle / 1e3,
        100.0 * p.found,
        color=FOUND,
        lw=1.6,
        label="found from energy alone, with 95 % interval",
    )
    low.set_xlabel("distance driven [km]")
    low.set_ylabel("slope over 1 km [%]")
    low.set_xlim(0.0, p.distance[-1] / 1e3)
    low.legend(loc="upper left", ncols=2, bbox_to_anchor=(0.0, 1.12), borderaxespad=0.0, handlelength=1.6)
    top.tick_params(labelbottom=False)
    side = figure.add_subplot(grid[:, 1])
    true, found = (100.0 * np.concatenate([getattr(r, n) for r in runs]) for n in ("recorded", "found"))
    reach = 1.06 * float(np.abs(np.concatenate([true, found])).max())
    side.plot([-reach, reach], [-reach, reach], color="#c4cad2", lw=1.0, zorder=0)
    side.scatter(true, found, s=11, color=FOUND, alpha=0.55, lw=0)
    side.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    side.set_xlabel("recorded slope [%]")
    side.set_ylabel("found slope [%]")
    side.set_title(f"{agreement['pieces']:.0f} km, correlation {agreement['correlation']:.2f}", color=NOTE)
    what = {
        "tripviewer": "Nissan Leaf, one motorway run",
        "twizy": "Renault Twizy, eleven runs (left: the longest)",
    }[name]
    figure.suptitle(what, x=0.01, ha="left", weight="bold")


def _surfaces(figure: Figure, found: list[Class]) -> None:
    """Resistance of every trip, trips in rows by their surface."""
    names = sorted({c.label for c in found}, key=lambda n: np.mean([c.value for c in found if c.label == n]))
    axes = figure.add_subplot()
    axes.axvline(0.0, color="#c4cad2", lw=0.8)
    for row, name in enumerate(names):
        own = sorted((c for c in found if c.label == name), key=lambda c: c.value)
        at = row + (np.linspace(-0.3, 0.3, len(own)) if len(own) > 1 else np.zeros(1))
        value = np.array([c.value for c in own])
        error = np.array([[c.value - c.low for c in own], [c.high - c.value for c in own]])
        axes.errorbar(value, at, xerr=error, fmt="none", ecolor=FOUND, alpha=0.3, lw=1.2)
        axes.scatter(
            value, at, s=18, color=FOUND, zorder=3, label="a trip, with 95 % interval" if row == 0 else None
        )
        mean = float(value.mean())
        axes.plot(
            [mean, mean],
            [row - 0.38, row + 0.38],
            color=RECORDED,
            lw=2.0,
            label="mean of the surface" if row == 0 else None,
        )
    axes.set_yticks(range(len(names)), [f"{n.replace('_', ' ').lower()}" for n in names])
    what = {"1": "resistance found beyond the model's, as a share of the weight [1]"}
    axes.set_xlabel(what.get(found[0].unit, "power found beyond the model's [W]"))
    # A trip of which every part was held out may have anything: its interval runs out of the picture.
    values = [c.value for c in found]
    axes.set_xlim(*(v + 0.4 * np.ptp(values) * side for v, side in ((min(values), -1), (max(values), 1))))
    axes.set_ylabel("withheld: surface")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.legend(loc="lower right")
    figure.suptitle("Clearpath Husky, straight driving, trips of one robot", x=0.01, ha="left", weight="bold")
