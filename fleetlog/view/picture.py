"""Pictures of an analysis: a PNG of all its shapes for paper, and single ones as SVG for pages."""

import io
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib import rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.ticker import MaxNLocator

from fleetlog.core.arrays import Array, Floats
from fleetlog.core.result import Bars, EdgeValues, Grid, Result, Series, Spread, half_width
from fleetlog.core.site import Site
from fleetlog.view import floorplan as floor
from fleetlog.view import palette
from fleetlog.view.palette import Scale, scales_of

Panel = Series | Bars | Spread
Layer = Grid | EdgeValues
WIDTH, DPI = 10.0, 150
LINE = 135  # Letters of the answer that fit on a line over the picture
WIDE = 0.6  # Two maps less high than this share of their width stand one below the other
PANEL_HEIGHT = 2.4
MAX_MAPS, MAX_PANELS = 24, 6
ON_PAGE = 5.6  # Width of a picture on a page [inches]: its text stays readable on a phone
STYLE = rc_params_from_file(Path(__file__).with_name("picture.mplstyle"), use_default_template=False)
SOFT, GRID = "#5a5f66", "#e3e6ea"
MAX_BARS, MAX_LABEL = 40, 28
SILENCE, NIGHT = 20.0, 6 * 3.6e9  # A gap of so many usual steps, or so long [us], is left out of the axis
SPREAD = "dots: runs, bars: mean with 95 % interval"
FEW = 60  # So many points are marked each: one alone is no line


def write_picture(result: Result, site: Site, out_png: str | Path) -> Path:
    """Draw answer and shapes of a result, 1500 points wide: maps of grids and road values, then panels."""
    maps: list[Any] = [s for s in result.shapes if isinstance(s, Layer)][:MAX_MAPS]
    if not maps and any(not isinstance(s, Panel) for s in result.shapes):
        maps = [None]
    ratio = _map_ratio(result, site)
    side = 1 if len(maps) == 2 and ratio < WIDE else 2
    panels: list[Any] = [s for s in result.shapes if isinstance(s, Panel)][:MAX_PANELS]
    rows = [maps[k : k + side] for k in range(0, len(maps), side)]
    rows += [panels[k : k + 2] for k in range(0, len(panels), 2)]
    with matplotlib.rc_context(STYLE):
        rooms = [float(np.clip((WIDTH / n - 1.0) * ratio + 1.2, 2.8, 11.0 - 2.5 * n)) for n in map(len, rows)]
        needs = [[panel_height(s) if isinstance(s, Panel) else 0.0 for s in row] for row in rows]
        heights = [max(n) or room for n, room in zip(needs, rooms, strict=True)]
        # Two sentences; details and lines of a table have blanks between their parts.
        said = wrap(" ".join([s for s in result.lines if rows and "  " not in s][:2]), LINE)
        head = 0.35 + 0.19 * len(said)
        tall = sum(heights) + head if rows else 4.0
        figure = Figure(figsize=(WIDTH, tall), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        engine: Any = figure.get_layout_engine()
        engine.set(w_pad=0.08, h_pad=0.05, hspace=0.03, rect=(0.0, 0.0, 1.0, 1.0 - head / tall))
        title = f"{site.name}: {result.name.replace('_', ' ')}"
        figure.text(0.01, 1.0 - 0.1 / tall, title, va="top", weight="bold", fontsize=12)
        figure.text(0.01, 1.0 - 0.34 / tall, "\n".join(said), va="top", color=floor.INK)
        if not rows:
            figure.text(0.01, 0.5, "\n".join(result.lines) or "nothing to draw", va="center")
        else:
            seen: set[str] = set()
            cells = figure.add_gridspec(len(rows), 2, height_ratios=heights)
            for k, row in enumerate(rows):
                for j, shape in enumerate(row):
                    spot = cells[k, j if row[1:] else slice(None)]
                    _draw(figure.add_subplot(spot), shape, result, site, told=seen)
        figure.savefig(out_png, format="png", dpi=DPI, facecolor="white", metadata={"Software": "fleetlog"})
    return Path(out_png)


def _map_ratio(result: Result, site: Site) -> float:
    x0, y0, x1, y1 = floor.frame_map(result, site)
    return (y1 - y0) / (x1 - x0)


def svg(
    result: Result, site: Site, shape: Layer | Panel | None = None, *, salt: str = "",
    scale: Scale | None = None, zone: str | None = None,
) -> str:  # fmt: skip
    """One map or panel of a result as an SVG element: its texts are text, everything it needs is in it.

    Without a ``shape``, the map of the site with the marks.  ``salt`` must differ among the pictures of a
    page; ``scale`` is the map's where several share it; ``zone`` the time zone, by default the site's."""
    own: Any = {"font.size": 10.0, "legend.fontsize": 9.0, "svg.fonttype": "none", "svg.hashsalt": salt}
    with matplotlib.rc_context({**STYLE, **own}):
        if isinstance(shape, Panel):
            height = panel_height(shape)
        else:
            height = float(np.clip((ON_PAGE - 1.0) * _map_ratio(result, site) + 1.3, 2.4, 7.0))
        figure = Figure(figsize=(ON_PAGE, height), dpi=DPI, layout="constrained")
        FigureCanvasSVG(figure)
        _draw(figure.add_subplot(), shape, result, site, scale, zone, told={*floor.AREAS})
        for axes in figure.axes:
            axes.set_title("", loc="left")  # a page says it beside the picture
        out, nothing = io.StringIO(), dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(out, format="svg", metadata=nothing)
    return out.getvalue()[out.getvalue().index("<svg") :]


def _draw(
    axes: Axes, shape: Layer | Panel | None, result: Result, site: Site, scale: Scale | None = None,
    zone: str | None = None, *, told: set[str],
) -> None:  # fmt: skip
    """A panel, or a map with a legend of what is not ``told`` yet; that grows by it."""
    if shape is not None:
        title = shape.y_label if isinstance(shape, Spread) else shape.name.replace("_", " ")
        axes.set_title("" if shape.name == result.name else f"{title[:1].upper()}{title[1:]}")
    axes.set_axisbelow(True if isinstance(shape, Panel) else "line")
    if isinstance(shape, Series):
        draw_series(axes, shape, zone or site.timezone)
    elif isinstance(shape, Spread):
        draw_spread(axes, shape)
    elif isinstance(shape, Bars):
        draw_bars(axes, shape, [s for s in result.shapes if isinstance(s, Series)])
    else:
        _draw_map(axes, shape, result, site, scale)
        keys = sorted(zip(*axes.get_legend_handles_labels(), strict=True), key=lambda k: k[1] in floor.AREAS)
        if keys := [(handle, name) for handle, name in keys if name not in told]:
            _legend(axes, [name for _, name in keys], [handle for handle, _ in keys])
            told |= {name for _, name in keys}


def _draw_map(axes: Axes, layer: Layer | None, result: Result, site: Site, scale: Scale | None) -> None:
    x0, y0, x1, y1 = floor.frame_map(result, site)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
    floor.draw_site(axes, site)
    if isinstance(layer, Grid) or (isinstance(layer, EdgeValues) and site.network is not None):
        scale = scale or scales_of(result.shapes)[layer.name]
        draw: Any = floor.draw_grid if isinstance(layer, Grid) else floor.draw_edges
        ticks: Any = scale.ticks()
        side = "horizontal" if x1 - x0 > 1.3 * (y1 - y0) else "vertical"
        if ticks is None and not np.mod(layer.values[np.isfinite(layer.values)], 1.0).any():
            ticks = MaxNLocator(nbins=8, integer=True)  # nobody passes one and a quarter times
        ends = "neither" if not scale.clipped else "both" if scale.diverging else "max"
        bar = axes.figure.colorbar(
            draw(axes, layer, scale, site), ax=axes, label=layer.label, extend=ends, ticks=ticks,
            orientation=side, format=None if ticks is None else "%g", shrink=0.7, aspect=30, pad=0.02,
        )  # fmt: skip
        bar.outline.set_visible(False)
    floor.draw_overlay(axes, result, site)
    floor.draw_furniture(axes, site)


def draw_series(axes: Axes, series: Series, zone: str = "UTC") -> None:
    """Curves, one above the other where they are stacked; over time in the hours of a time zone."""
    names = [name.replace("_", " ") for name in series.y]
    x = np.asarray(series.x)
    values = np.array(list(series.y.values()), float).reshape(len(names), len(x))
    if series.over_time:
        x, values = _over_time(axes, x, values, zone)
    if series.stacked:
        # Energy that flows back lies below zero, and is not taken off what flows out.
        colours, known = [palette.paper_colour("", i) for i in range(len(names))], np.nan_to_num(values)
        axes.stackplot(x, np.maximum(known, 0.0), labels=names, colors=colours, lw=0)
        axes.stackplot(x, np.minimum(known, 0.0), colors=colours, lw=0)
    else:
        for i, (name, y) in enumerate(zip(names, values, strict=True)):
            mark = "." if len(x) <= FEW else ""
            look: Any = {"color": palette.paper_colour(name, i), "clip_on": not mark, "label": name}
            axes.plot(x, y, marker=mark, ls="-", lw=1.1, **look)
    axes.set_xlabel(f"time ({zone.replace('_', ' ')})" if series.over_time else series.x_label)
    axes.set_ylabel(series.y_label)
    axes.margins(x=0)
    if series.counts:
        axes.set_ylim(bottom=axes.get_ylim()[0] if (values < 0.0).any() else 0.0)
    axes.grid(axis="y", color=GRID, lw=0.6)
    if len(names) > 1:
        _legend(axes, names)


def _over_time(axes: Axes, x: Array, values: Floats, zone: str) -> tuple[Array, Floats]:
    """Times of a zone; silences are cut out of the axis and marked: a log of shifts has nothing at night."""
    local = pd.to_datetime(x, unit="us", utc=True).tz_convert(zone).tz_localize(None).to_numpy()
    steps = np.diff(local).astype("timedelta64[us]").astype(float)
    # A short step: of few points, or of short shifts, the median is a silence itself.
    usual = float(np.quantile(steps, 0.25, method="lower")) if len(steps) else 0.0
    if not len(cut := np.flatnonzero(steps > min(SILENCE * usual, max(2.0 * usual, NIGHT)))):
        # These two classes of matplotlib carry no types.
        locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        return local, values
    steps[cut] = 2.0 * usual
    at = np.concatenate([[0.0], np.cumsum(steps)])
    for k in cut:
        axes.axvline(0.5 * (at[k] + at[k + 1]), color=SOFT, lw=0.6, ls=":")
    first = np.concatenate([[0], cut + 1])
    shown = first[:: -(-len(first) // 6)]
    axes.set_xticks(at[shown], [f"{pd.Timestamp(local[k]):%d %b\n%H:%M}" for k in shown], ha="left")
    # A row of nothing in every silence breaks the curves.
    return np.insert(at, cut + 1, 0.5 * (at[cut] + at[cut + 1])), np.insert(values, cut + 1, np.nan, axis=1)


def draw_bars(axes: Axes, bars: Bars, curves: Sequence[Series] = ()) -> None:
    """Bars from the top down, with their parts or their numbers; what is drawn as a curve has its colour."""
    tints = {name.replace("_", " "): k for curve in curves for k, name in enumerate(curve.y)}
    labels = list(bars.labels[:MAX_BARS])
    at = np.arange(len(labels))
    left = np.zeros(len(labels))
    for i, (name, part) in enumerate((bars.parts or {"": bars.values}).items()):
        width = np.asarray(part[: len(labels)], float)
        tones = [palette.paper_colour(name, i if bars.parts else tints.get(of, 0)) for of in labels]
        drawn = axes.barh(at, width, left=left, color=tones, height=0.72, label=name.replace("_", " "))
        left = left + width
        if not bars.parts:
            # Three digits of the longest, and as many decimals of the others.
            digits = int(np.clip(2 - np.floor(np.log10(max(np.abs(width).max(initial=0.0), 0.01))), 0, 3))
            axes.bar_label(drawn, [f"{v:,.{digits}f}" for v in width], padding=3, fontsize=8, color=floor.INK)
            axes.margins(x=0.1)
    if not left.any():
        axes.set_xlim(0.0, 1.0)
    axes.set_yticks(at, [t if len(t) <= MAX_LABEL else t[: MAX_LABEL - 1] + "…" for t in labels])
    axes.set(ylim=(max(len(labels), 1) - 0.5, -0.5), xlabel=bars.label)
    axes.grid(axis="x", color=GRID, lw=0.6)
    if bars.parts:
        axes.margins(x=0)
        _legend(axes, list(bars.parts))
    if (more := len(bars.labels) - len(labels)) > 0:
        axes.text(1, 0, f"and {more} more", transform=axes.transAxes, ha="right", va="bottom", color=SOFT)


def panel_height(panel: Panel) -> float:
    """Height that a panel needs [inches]: labelled bars a line each, an experiment one for every curve."""
    if isinstance(panel, Bars):
        return 1.1 + 0.19 * max(min(len(panel.labels), MAX_BARS), 3) + (0.25 if panel.parts else 0.0)
    return PANEL_HEIGHT + (0.19 * min(len(panel.curves), MAX_BARS) if isinstance(panel, Spread) else 0.0)


def draw_spread(axes: Axes, spread: Spread) -> None:
    """Runs of an experiment as dots, their mean and its 95 % interval; numbers go along, names down."""
    number = all(v.replace(".", "", 1).isdigit() for v in spread.values)
    at = np.array([float(v) for v in spread.values]) if number else np.arange(len(spread.values), dtype=float)
    along = slice(None, None, 1 if number else -1)
    for k, (name, runs) in enumerate(spread.curves.items()):
        # Curves side by side do not hide one another's bars.
        places = at + 0.012 * float(np.ptp(at)) * (k - 0.5 * (len(spread.curves) - 1))
        look: Any = {"color": palette.paper_colour("", k), "ms": 4}
        known = np.flatnonzero([len(r) for r in runs])
        for j in known:
            axes.plot(*[np.full(len(runs[j]), places[j]), runs[j]][along], ".", alpha=0.35, **look)
        half = np.nan_to_num([half_width(runs[j]) for j in known])
        look |= {"yerr" if number else "xerr": half, "fmt": "o-" if number else "o", "label": name or None}
        ends: Any = [places[known], np.array([runs[j].mean() for j in known])][along]
        axes.errorbar(*ends, lw=1.2, capsize=3, **look)
    if number:
        axes.set_xticks(at, list(spread.values))
        axes.set(xlabel=f"{spread.x_label} ({SPREAD})", ylim=(0.0, None))
    else:
        axes.set_yticks(at, list(spread.values))
        axes.set(xlabel=SPREAD, ylabel=spread.x_label, ylim=(len(at) - 0.5, -0.5))
    axes.grid(axis="y" if number else "x", color=GRID, lw=0.6)
    if any(spread.curves):
        _legend(axes, list(spread.curves))


def _legend(axes: Axes, names: Sequence[str], handles: Sequence[Any] | None = None) -> None:
    """Between the title and the data, never on it; in as many columns as there is room for over the axes."""
    figure, place = axes.get_figure(root=True), axes.get_subplotspec()
    assert figure is not None and place is not None
    room = figure.get_figwidth() * len(place.colspan) / place.get_gridspec().ncols - 1.0
    size = FontProperties(size=matplotlib.rcParams["legend.fontsize"]).get_size_in_points()
    for columns in range(min(len(names), 6), 0, -1):
        longest = [max(map(len, part)) for part in np.array_split(np.array(names, object), columns)]
        if 0.35 * columns + 0.0071 * size * sum(longest) < room:
            break
    axes.title.set_y(1.0)
    axes.set_title(axes.get_title(loc="left"), pad=8.0 + 13.0 * -(-len(names) // columns), loc="left")
    axes.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.1,
        handlelength=1.2, columnspacing=1.2, handletextpad=0.5,
    )  # fmt: skip
