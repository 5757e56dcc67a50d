"""The site on paper, in axes of metres: roads, buildings, places, heat, scale bar and north arrow."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.patheffects import withStroke

from fleetlog.core.arrays import Floats
from fleetlog.core.result import EdgeValues, Flows, Grid, Marks, MovingLines, Result
from fleetlog.core.site import Site
from fleetlog.simulate.track import shifted, stretch
from fleetlog.view import palette, ribbons
from fleetlog.view.clock import Extent, around, shapes_outline
from fleetlog.view.palette import Scale, colour_map

INK, ROAD, BUILDING = "#33373d", "#b9c0c9", "#eceef1"
MAX_LABELS = 25
AREAS = ("building", "zone", "zone with a speed limit")
PLACES = {"pick": "pick place", "drop": "drop place", "park": "parking", "charge": "charger"}


def frame_map(result: Result, site: Site) -> Extent:
    """Limits of a map [m]: everything drawn, and a rim."""
    x0, y0, x1, y1 = around(shapes_outline(result, site))
    rim = 0.05 * max(x1 - x0, y1 - y0, 5.0)
    return x0 - rim, y0 - rim, x1 + rim, y1 + rim


def draw_site(axes: Axes, site: Site) -> None:
    """Buildings as pale areas, the rims of zones, roads as grey lines."""
    slow, other = ([z for z in site.zones if np.isfinite(z.speed_limit) == yes] for yes in (True, False))
    kinds: Any = ((site.buildings, "#c9cdd3", "-"), (other, "#6f79b5", "--"), (slow, "#b98a2f", "--"))
    for (areas, rim, line), name in zip(kinds, AREAS, strict=True):
        look: Any = {"facecolors": BUILDING if line == "-" else "none", "edgecolors": rim, "lw": 0.8}
        look |= {"linestyles": line, "zorder": 0.0 if line == "-" else 0.5, "label": name if areas else ""}
        axes.add_collection(PolyCollection([ribbons.open_ring(a.polygon) for a in areas], **look))
    axes.add_collection(LineCollection(_road_lines(site), colors=ROAD, linewidths=1.0, zorder=1))
    axes.set(xlabel="x [m]", ylabel="y [m]")


def _road_lines(site: Site) -> list[Floats]:
    network = site.network
    return [] if network is None else [network.polyline(i)[:, :2] for i in range(len(network))]


def draw_grid(axes: Axes, grid: Grid, scale: Scale, site: Site) -> Any:
    """Heat on the floor; what a colour bar is made of."""
    rows, columns = grid.values.shape
    where = (grid.x0, grid.x0 + columns * grid.cell, grid.y0, grid.y0 + rows * grid.cell)
    values = np.ma.masked_invalid(np.where(grid.values == 0.0, np.nan, grid.values))
    # Where nothing is significant, all pale would be a blank picture.
    alpha = np.where(grid.mask, 1.0, 0.3) if grid.mask is not None and grid.mask.any() else None
    x, y = axes.get_xlim(), axes.get_ylim()
    image = axes.imshow(
        values, origin="lower", extent=where, cmap=colour_map(grid.diverging, False), norm=scale.norm(),
        interpolation="nearest", alpha=alpha, zorder=1.5,
    )  # fmt: skip
    axes.set(xlim=x, ylim=y)
    # Fine lines over the heat, so that the roads stay readable.
    fine: Any = {"colors": "#1d2024", "linewidths": 0.35, "alpha": 0.55, "zorder": 2}
    axes.add_collection(LineCollection(_road_lines(site), **fine))
    if alpha is not None:
        _key(axes, "pale: no more than chance", marker="s", color="#f0d6cc")
    elif grid.mask is not None:
        text = "No cell differs by more than chance: do not read a pattern into the colours."
        look: Any = {"weight": "bold", "color": "#a03020", "ha": "left", "va": "top", "fontsize": 8.5}
        axes.annotate(text, (0.01, 0.99), xycoords="axes fraction", zorder=7, **look)
    return image


def draw_edges(axes: Axes, layer: EdgeValues, scale: Scale, site: Site) -> Any:
    """Values of a road's directions side by side, each where it is driven; what a colour bar is made of."""
    network = site.roads()
    span = max(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
    shift = 0.006 * float(span) * (1.0 if site.traffic == "left" else -1.0)
    keep = np.flatnonzero((layer.edge >= 0) & np.isfinite(layer.values))
    keep = keep[np.argsort(np.abs(layer.values[keep]), kind="stable")]
    lines = []
    for edge, start, end in zip(layer.edge[keep], layer.start[keep], layer.end[keep], strict=True):
        line = stretch(network.polyline(edge), float(start), float(end))
        lines.append((shifted(line, shift) if network.reverse[edge] >= 0 else line)[:, :2])
    strips = LineCollection(
        lines, cmap=colour_map(layer.diverging, False), norm=scale.norm(),
        linewidths=3.2, capstyle="butt", zorder=2,
    )  # fmt: skip
    strips.set_array(layer.values[keep])
    axes.add_collection(LineCollection(lines, colors="#8a9099", linewidths=4.2, capstyle="butt", zorder=1.8))
    axes.add_collection(strips)
    return strips


def draw_overlay(axes: Axes, result: Result, site: Site) -> None:
    """Marks and critical lines, over every map; where arrows lead from place to place, names of places."""
    taken: list[Extent] = []
    for shape in result.shapes:
        if isinstance(shape, MovingLines):
            _draw_lines(axes, shape)
        elif isinstance(shape, Flows):
            _draw_flows(axes, shape)
        elif isinstance(shape, Marks) and len(shape.xy):
            _draw_marks(axes, shape, taken)
    if any(isinstance(s, Flows) for s in result.shapes):
        at, names = np.array([[p.x, p.y] for p in site.places]).reshape(-1, 2), [p.id for p in site.places]
        _label(axes, at, names, np.full(len(at), 0.006 * float(np.ptp(axes.get_xlim()))), taken)


def _draw_flows(axes: Axes, flows: Flows) -> None:
    """Bent arrows, so that both directions are seen; the strongest on top."""
    share = flows.weight / max(float(flows.weight.max(initial=0.0)), 1e-300)
    for k in np.argsort(share):
        axes.add_patch(FancyArrowPatch(
            tuple(flows.start[k]), tuple(flows.end[k]), connectionstyle="arc3,rad=0.18", arrowstyle="-|>",
            mutation_scale=6.0 + 6.0 * float(share[k]), lw=0.5 + 2.5 * float(share[k]), color="#2a6fa8",
            alpha=0.35 + 0.5 * float(share[k]), shrinkA=2.0, shrinkB=3.0, zorder=2.6,
        ))  # fmt: skip
    if len(share):
        rest = f"; the {len(share)} busiest of {flows.of:,} pairs" if flows.of > len(share) else ""
        text = f"widest arrow: {flows.weight.max():.0f} {flows.label}{rest}"
        _key(axes, text, marker=">", ls="-", lw=2.5, ms=6, color="#2a6fa8")


def _key(axes: Axes, text: str, **look: Any) -> None:
    """A line of the map's legend."""
    axes.plot([], [], label=text, **{"ls": "", "ms": 7, "lw": 1.2, **look})


def _draw_lines(axes: Axes, shape: MovingLines) -> None:
    """All lines of all times laid over one another: dense places grow dark."""
    every = np.concatenate([np.zeros((0, 2, 2)), *shape.lines])
    flags = np.concatenate([np.zeros(0, bool), *shape.critical]).astype(bool)
    for critical, colour in ((False, "#7fa8c4"), (True, "#c22e2a")):
        strips = every[flags == critical]
        if shape.label and len(strips):
            _key(axes, shape.label + (", slow: critical" if critical else ""), ls="-", color=colour)
        strips = strips[:: max(1, len(strips) // 20_000)]
        look: Any = {"alpha": float(np.clip(40.0 / max(len(strips), 1), 0.02, 0.5)), "zorder": 2.5}
        axes.add_collection(LineCollection(list(strips), colors=colour, linewidths=0.9, **look))


def _draw_marks(axes: Axes, marks: Marks, taken: list[Extent]) -> None:
    """Rings (chargers: discs) with labels where there is room for them; ``taken`` grows by both."""
    colour = tuple(c / 255 for c in palette.MARKS[marks.kind])
    small = (0.002 if marks.kind == "point" else 0.006) * float(np.ptp(axes.get_xlim()))
    sizes = np.maximum(np.asarray(marks.size, float), small)
    circles = [Circle((x, y), r) for (x, y), r in zip(marks.xy, sizes, strict=True)]
    face = colour if marks.kind in ("charger", "point") else "none"
    look: Any = {"linewidths": 1.2, "alpha": 0.6 if marks.kind == "point" else 1.0, "zorder": 3}
    axes.add_collection(PatchCollection(circles, facecolors=face, edgecolors=colour, **look))
    size = 4 if marks.kind == "point" else 8
    _key(axes, marks.name.replace("_", " "), marker="o", mfc=face, color=colour, ms=size)
    _label(axes, marks.xy, marks.labels, sizes, taken)


def _label(axes: Axes, at: Floats, labels: Sequence[str], sizes: Floats, taken: list[Extent]) -> None:
    """Texts beside the first of some rings, at best on none of these."""
    rings = [(x - r, y - r, x + r, y + r) for (x, y), r in zip(at, sizes, strict=True)]
    for k, label in list(enumerate(labels))[:MAX_LABELS]:
        others, (x, y) = rings[:k] + rings[k + 1 :], at[k]
        if label and (spot := _free_spot(axes, x, y, sizes[k], label, taken, others)) is not None:
            axes.annotate(
                label, spot, fontsize=7.5, color=INK, ha="center", va="center", zorder=5,
                annotation_clip=True, path_effects=[withStroke(linewidth=3.5, foreground="white")],
            )  # fmt: skip


def _free_spot(
    axes: Axes, x: float, y: float, size: float, label: str, taken: list[Extent], rings: Sequence[Extent]
) -> tuple[float, float] | None:
    """Middle of a label about its mark, over no other one and at best no ring; None where none is."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    inches = figure.get_size_inches()[0] * 0.85 / max(len({a.get_position().x0 for a in figure.axes}), 1)
    point = float(np.ptp(axes.get_xlim())) / (72.0 * inches)
    half, tall = 2.3 * point * len(label), 4.8 * point
    sides = (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)
    for full, (dx, dy) in product(((*taken, *rings), tuple(taken)), sides):
        cx, cy = x + dx * (size + half + point), y + dy * (size + tall)
        box = cx - half, cy - tall, cx + half, cy + tall
        if not any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in full):
            taken.append(box)
            return cx, cy
    return None


def draw_furniture(axes: Axes, site: Site) -> None:
    """Places of the site, scale bar and north arrow."""
    for kind in sorted({p.kind for p in site.places}):
        x, y = np.array([[p.x, p.y] for p in site.places if p.kind == kind]).T
        colour = tuple(0.75 * c / 255 for c in palette.PLACES[kind])
        axes.scatter(x, y, s=16, marker="s", color=colour, zorder=2.8, label=PLACES[kind], ec="white", lw=0.5)
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    raw = (x1 - x0) / 5.0
    power = 10.0 ** np.floor(np.log10(raw))
    length = float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= raw))
    right, base = x1 - 0.02 * (x1 - x0), y0 + 0.03 * (y1 - y0)
    axes.plot([right - length, right], [base, base], color=INK, lw=2.4, solid_capstyle="butt", zorder=6)
    beside: Any = {"textcoords": "offset points", "ha": "center", "color": INK, "zorder": 6}
    axes.annotate(f"{length:g} m", (right - length / 2, base), xytext=(0, 3), fontsize=8, **beside)
    # North is (sin, cos) of the rotation, by which the x axis is turned counter-clockwise from east.
    rotation = 0.0 if site.frame is None else site.frame.rotation
    north, at = np.array([np.sin(rotation), np.cos(rotation)]), (0.98, 0.90)
    look: Any = {"arrowstyle": "-|>", "color": INK, "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
    beside |= {"xycoords": "axes fraction", "va": "center", "fontsize": 8.5, "weight": "bold"}
    axes.annotate("", at, xytext=tuple(-26.0 * north), arrowprops=look, **beside)
    axes.annotate("N", at, xytext=tuple(8.0 * north), **beside)
