"""Pictures of an analysis: a PNG of all its shapes for paper, and single ones as SVG for pages."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleetlog.core.result import Bars, EdgeValues, Flows, Grid, Marks, MovingLines, Result, Series, Spread
from fleetlog.core.site import Site
from fleetlog.view.floorplan import draw_edges, draw_furniture, draw_grid, draw_overlay, draw_site, frame_map
from fleetlog.view.palette import Scale, scales_of
from fleetlog.view.panels import bars_height, draw_bars, draw_series, draw_spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Panel = Series | Bars | Spread
Layer = Grid | EdgeValues
WIDTH, DPI = 10.0, 150
PANEL_HEIGHT = 2.4
MAX_MAPS, MAX_PANELS = 24, 6
ON_PAGE = 5.6  # Width of a picture on a page [inches]: its text stays readable on a phone
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

    maps: list[Any] = [s for s in result.shapes if isinstance(s, Grid | EdgeValues)][:MAX_MAPS]
    if not maps and any(isinstance(s, Marks | MovingLines | Flows) for s in result.shapes):
        maps = [None]
    panels = [s for s in result.shapes if isinstance(s, Series | Bars | Spread)][:MAX_PANELS]
    with matplotlib.rc_context(STYLE):
        columns, beside = (2 if len(shown) > 1 else 1 for shown in (maps, panels))
        room = (WIDTH / columns - 1.0) * _map_ratio(result, site) + 0.9
        heights = [float(np.clip(room, 2.6, 8.5 if columns == 1 else 6.0))] * -(-len(maps) // columns)
        needs = [bars_height(p) if isinstance(p, Bars) else PANEL_HEIGHT for p in panels]
        heights += [max(PANEL_HEIGHT, *needs[k : k + beside]) for k in range(0, len(needs), beside)]
        figure = Figure(figsize=(WIDTH, sum(heights) + 0.5 or 4.0), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        engine: Any = figure.get_layout_engine()
        engine.set(w_pad=0.08, h_pad=0.05, hspace=0.03)
        figure.suptitle(f"{site.name}: {result.name.replace('_', ' ')}", x=0.01, ha="left", weight="bold")
        if not heights:
            figure.text(0.01, 0.5, "\n".join(result.lines) or "nothing to draw", va="center")
        else:
            cells = figure.add_gridspec(len(heights), 2, height_ratios=heights)
            first = len(heights) - -(-len(panels) // beside)
            for shown, across, row in ((maps, columns, 0), (panels, beside, first)):
                for k, shape in enumerate(shown):
                    alone = across == 1 or (shown is panels and k == len(shown) - 1 and k % 2 == 0)
                    spot = cells[row + k // across, slice(None) if alone else k % 2]
                    _draw(figure.add_subplot(spot), shape, result, site)
        figure.savefig(out_png, format="png", dpi=DPI, facecolor="white", metadata={"Software": "fleetlog"})
    return Path(out_png)


def _map_ratio(result: Result, site: Site) -> float:
    x0, y0, x1, y1 = frame_map(result, site)
    return (y1 - y0) / (x1 - x0)


def svg(
    result: Result, site: Site, shape: Layer | Panel | None = None, *, salt: str = "",
    scale: Scale | None = None, zone: str | None = None,
) -> str:  # fmt: skip
    """One map or panel of a result as an SVG element: its texts are text, everything it needs is in it.

    Without a ``shape``, the map of the site with the marks.  ``salt`` must differ among the pictures of a
    page; ``scale`` is that of the map where several share it; ``zone`` the time zone, by default the site's.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    own: Any = {"font.size": 10.0, "legend.fontsize": 9.0, "svg.fonttype": "none", "svg.hashsalt": salt}
    with matplotlib.rc_context({**STYLE, **own}):
        if isinstance(shape, Panel):
            height = bars_height(shape) if isinstance(shape, Bars) else PANEL_HEIGHT
        else:
            height = float(np.clip((ON_PAGE - 1.0) * _map_ratio(result, site) + 1.0, 2.4, 7.0))
        figure = Figure(figsize=(ON_PAGE, height), dpi=DPI, layout="constrained")
        FigureCanvasSVG(figure)
        _draw(figure.add_subplot(), shape, result, site, scale, zone)
        for axes in figure.axes:
            axes.set_title("", loc="left")  # a page says it beside the picture
        out, nothing = io.StringIO(), dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(out, format="svg", metadata=nothing)
    return out.getvalue()[out.getvalue().index("<svg") :]


def _draw(
    axes: Axes, shape: Layer | Panel | None, result: Result, site: Site, scale: Scale | None = None,
    zone: str | None = None,
) -> None:  # fmt: skip
    """A panel, or a map."""
    if isinstance(shape, Series):
        draw_series(axes, shape, zone or site.timezone)
    elif isinstance(shape, Spread):
        draw_spread(axes, shape)
    elif isinstance(shape, Bars):
        draw_bars(axes, shape)
    else:
        _draw_map(axes, shape, result, site, scale)


def _draw_map(axes: Axes, layer: Layer | None, result: Result, site: Site, scale: Scale | None) -> None:
    x0, y0, x1, y1 = frame_map(result, site)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
    draw_site(axes, site)
    if layer is not None:
        axes.set_title(layer.name.replace("_", " "))
    if isinstance(layer, Grid) or (isinstance(layer, EdgeValues) and site.network is not None):
        scale = scale or scales_of(result.shapes)[layer.name]
        draw: Any = draw_grid if isinstance(layer, Grid) else draw_edges
        ticks, side = scale.ticks(), "horizontal" if x1 - x0 > 1.3 * (y1 - y0) else "vertical"
        ends = "neither" if not scale.clipped else "both" if scale.diverging else "max"
        bar = axes.figure.colorbar(
            draw(axes, layer, scale, site), ax=axes, label=layer.label, extend=ends, ticks=ticks,
            orientation=side, format=None if ticks is None else "%g", shrink=0.7, aspect=30, pad=0.02,
        )  # fmt: skip
        bar.outline.set_visible(False)
    draw_overlay(axes, result, None if layer is None else layer.name)
    draw_furniture(axes, site)
