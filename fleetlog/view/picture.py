"""One PNG of an analysis, for paper: maps in metres with scale and north arrow, curves and bars below."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import Bars, EdgeValues, Grid, Marks, MovingLines, Result, Series, Spread
from fleetlog.core.site import Site
from fleetlog.view import palette
from fleetlog.view.floorplan import draw_furniture, draw_map_layer, draw_overlay, draw_site, frame_map
from fleetlog.view.scales import scales_of
from fleetlog.view.spread import draw_spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Panel = Series | Bars | Spread
WIDTH, DPI = 10.0, 150
PANEL_HEIGHT = 2.4
MAX_MAPS, MAX_PANELS, MAX_BARS = 24, 6, 20
STYLE: Any = {
    "font.family": "DejaVu Sans", "font.size": 9.0, "axes.titlesize": 10.5, "axes.titlelocation": "left",
    "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#5a5f66",
    "axes.labelcolor": "#33373d", "xtick.color": "#5a5f66", "ytick.color": "#5a5f66", "legend.frameon": False,
    "legend.fontsize": 8.0, "axes.grid": False, "text.parse_math": False,
}  # fmt: skip


def write_picture(result: Result, site: Site, out_png: str | Path) -> Path:
    """Draw the shapes of a result; 1500 points wide, in colours that colour-blind people tell apart.

    Every grid and every set of road values is a map of its own over the roads, with the marks and critical
    lines on each; curves and bars follow below.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    maps, panels = _split(result)
    with matplotlib.rc_context(STYLE):
        columns = 2 if len(maps) > 1 else 1
        map_rows = -(-len(maps) // columns)
        panel_rows = -(-len(panels) // 2) if len(panels) > 1 else len(panels)
        ratio = _map_ratio(result, site)
        map_height = float(np.clip((WIDTH / columns - 1.0) * ratio + 0.9, 2.6, 8.5 if columns == 1 else 6.0))
        heights = [map_height] * map_rows + [PANEL_HEIGHT] * panel_rows
        figure = Figure(figsize=(WIDTH, sum(heights) + 0.5 or 4.0), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        figure.get_layout_engine().set(w_pad=0.08, h_pad=0.05, hspace=0.03)  # type: ignore[union-attr, call-arg]
        figure.suptitle(f"{site.name}: {result.name.replace('_', ' ')}", x=0.01, ha="left", weight="bold")
        _place(figure, heights, map_rows, columns, maps, panels, result, site)
        figure.savefig(out_png, format="png", dpi=DPI, facecolor="white", metadata={"Software": "fleetlog"})
    return Path(out_png)


def _split(result: Result) -> tuple[list[Grid | EdgeValues | None], list[Panel]]:
    maps: list[Grid | EdgeValues | None] = [
        *[s for s in result.shapes if isinstance(s, Grid | EdgeValues)][:MAX_MAPS]
    ]
    if not maps and any(isinstance(s, Marks | MovingLines) for s in result.shapes):
        maps = [None]
    return maps, [s for s in result.shapes if isinstance(s, Series | Bars | Spread)][:MAX_PANELS]


def _map_ratio(result: Result, site: Site) -> float:
    x0, y0, x1, y1 = frame_map(result, site)
    return (y1 - y0) / (x1 - x0)


def _place(
    figure: Figure, heights: list[float], map_rows: int, columns: int,
    maps: list[Grid | EdgeValues | None], panels: list[Panel], result: Result, site: Site,
) -> None:  # fmt: skip
    if not heights:
        figure.text(0.01, 0.5, "\n".join(result.lines) or "nothing to draw", va="center")
        return
    cells = figure.add_gridspec(len(heights), 2, height_ratios=heights)

    def spot(first: int, k: int, wide: bool) -> Any:
        return cells[first + k, :] if wide else cells[first + k // 2, k % 2]

    for k, layer in enumerate(maps):
        _draw_map(figure, figure.add_subplot(spot(0, k, columns == 1)), layer, result, site)
    for k, panel in enumerate(panels):
        axes = figure.add_subplot(spot(map_rows, k, len(panels) == 1))
        if isinstance(panel, Series):
            _draw_series(axes, panel)
        elif isinstance(panel, Spread):
            draw_spread(axes, panel)
        else:
            _draw_bars(axes, panel)


def _draw_map(
    figure: Figure, axes: Axes, layer: Grid | EdgeValues | None, result: Result, site: Site
) -> None:
    extent = frame_map(result, site)
    axes.set_xlim(extent[0], extent[2])
    axes.set_ylim(extent[1], extent[3])
    axes.set_aspect("equal")
    draw_site(axes, site)
    if layer is not None:
        image = draw_map_layer(axes, layer, site, scales_of(result.shapes)[layer.name])
        axes.set_title(layer.name.replace("_", " "))
        if image is not None:
            wide = extent[2] - extent[0] > 1.3 * (extent[3] - extent[1])
            bar = figure.colorbar(
                image.mappable, ax=axes, label=layer.label, extend=image.extend,
                orientation="horizontal" if wide else "vertical", shrink=0.7, aspect=30, pad=0.02,
            )  # fmt: skip
            bar.outline.set_visible(False)
    draw_overlay(axes, result, None if layer is None else layer.name)
    draw_furniture(axes, site)


def _draw_series(axes: Axes, series: Series) -> None:
    x: Any = np.asarray(series.x)
    names = [name.replace("_", " ") for name in series.y]
    if series.over_time:
        x = x.astype("datetime64[us]")
    if series.stacked:
        values = np.nan_to_num(np.array(list(series.y.values()), float))
        axes.stackplot(
            x, values, labels=names, colors=[palette.dark_colour(i) for i in range(len(values))], lw=0
        )
    else:
        for i, (name, y) in enumerate(zip(names, series.y.values(), strict=True)):
            axes.plot(x, y, lw=1.1, color=palette.dark_colour(i), label=name)
    if series.over_time:
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        # These two classes of matplotlib carry no types.
        locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_title(series.name.replace("_", " "))
    axes.set_xlabel("UTC" if series.over_time else series.x_label)
    axes.set_ylabel(series.y_label)
    axes.margins(x=0)
    axes.grid(axis="y", color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)
    if len(names) > 3 or (series.stacked and len(names) > 1):
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.3, reverse=series.stacked)
    elif len(names) > 1:
        axes.legend()


def _draw_bars(axes: Axes, bars: Bars) -> None:
    labels, values = list(bars.labels[:MAX_BARS]), np.asarray(bars.values[:MAX_BARS], float)
    at = np.arange(len(labels))
    axes.barh(at, values, color=palette.dark_colour(0), height=0.72)
    axes.set_yticks(at, [t if len(t) <= 28 else t[:27] + "…" for t in labels])
    axes.invert_yaxis()
    axes.set_xlabel(bars.label)
    axes.set_title(bars.name.replace("_", " "))
    axes.grid(axis="x", color="#e3e6ea", lw=0.6)
    axes.set_axisbelow(True)
    left_out = len(bars.labels) - len(labels)
    if left_out > 0:
        axes.annotate(
            f"and {left_out} more", (1, 0), xycoords="axes fraction", ha="right", va="bottom", color="#5a5f66"
        )
