"""``recording.rrd`` of an analysis: its shapes on the site's floor, its curves and its answer in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fleetlog.core.result import Bars, EdgeValues, Flows, Grid, Marks, MovingLines, Result, Series, Shape
from fleetlog.core.site import Site
from fleetlog.view import blueprint, palette, ribbons, thin
from fleetlog.view.extent import Extent, Floats, around, shapes_outline
from fleetlog.view.fleet import curve_style, log_curve, with_gaps
from fleetlog.view.marks import arc, head
from fleetlog.view.meshes import join, mesh_of
from fleetlog.view.scales import Scale, scales_of, screen_colours
from fleetlog.view.scene import drawn_width, lane, log_site, mesh3d
from fleetlog.view.stream import Stream, entity, open_stream, verbatim

MARK_COLOURS = {
    "place": palette.PLACES["pick"], "charger": palette.PLACES["charge"], "critical": palette.CRITICAL,
    "point": (240, 240, 245), **palette.PLACES,
}  # fmt: skip
SERIES_COLOURS = [palette.vehicle_colour(i) for i in range(24)]
MAX_MAPS = 9
WIDE = 2.5
"""Width by height of one of two maps above one another."""


def write_result_recording(result: Result, site: Site, out_rrd: str | Path) -> Path:
    """The shapes of a result as an .rrd file: heat on the floor, values along the roads, marks, moving lines,
    curves.

    ``out_rrd`` appears whole or not at all, and replaces an older one.  Bars, and curves over something else
    than time, are in the picture and in the text only.
    """
    outline = shapes_outline(result, site)
    extent = around(outline)
    with open_stream(Path(out_rrd), f"{site.name}, {result.name}") as stream:
        log_site(stream, site)
        scales = scales_of(result.shapes)
        texts = [_log_shape(stream, site, shape, extent, scales) for shape in result.shapes]
        _log_answer(stream, result, list(dict.fromkeys(t for t in texts if t)))
        if not any(
            isinstance(s, MovingLines) or (isinstance(s, Series) and s.over_time) for s in result.shapes
        ):
            # A view of a recording without any time stays on "static"; one instant makes the timeline.
            stream.columns(
                "/result/instant", np.zeros(1, np.int64), lambda rows: rr.Scalars.columns(scalars=[0.0])
            )
        blueprint.send(stream, _screen(result, outline))
    return Path(out_rrd)


def _log_shape(stream: Stream, site: Site, shape: Shape, extent: Extent, scales: dict[str, Scale]) -> str:
    """Draw one shape; a line of Markdown that says how to read it."""
    path = entity("result", shape.name)
    if isinstance(shape, Grid):
        return _log_grid(stream, path, shape, scales[shape.name], extent)
    if isinstance(shape, EdgeValues):
        return (
            _log_edges(stream, path, shape, site, scales[shape.name], extent)
            if site.network is not None
            else ""
        )
    if isinstance(shape, Marks):
        return _log_marks(stream, path, shape)
    if isinstance(shape, MovingLines):
        return _log_lines(stream, path, shape)
    if isinstance(shape, Flows):
        return _log_flows(stream, path, shape)
    if isinstance(shape, Series):
        return _log_series(stream, shape)
    # Curves with intervals are in the picture; in the recording is the table of them.
    return _bars_text(shape) if isinstance(shape, Bars) else ""


def _log_grid(stream: Stream, path: str, grid: Grid, scale: Scale, extent: Extent) -> str:
    rgba = screen_colours(np.where(grid.values == 0.0, np.nan, grid.values), scale)
    if grid.mask is not None:
        rgba[..., 3] = np.where(grid.mask, rgba[..., 3], rgba[..., 3] // 5)
    size = rr.components.ImageFormat(
        width=rgba.shape[1], height=rgba.shape[0], color_model="RGBA", channel_datatype="U8"
    )
    raster = rr.GridMap(
        data=np.ascontiguousarray(rgba[::-1]).tobytes(), format=size, cell_size=grid.cell,
        translation=[grid.x0, grid.y0, 0.0], opacity=0.9,
    )  # fmt: skip
    stream.static(path, raster)
    return _legend(stream, path, grid.label, scale, extent)


def _log_edges(stream: Stream, path: str, shape: EdgeValues, site: Site, scale: Scale, extent: Extent) -> str:
    network = site.roads()
    rgba = screen_colours(shape.values, scale)
    meshes = []
    for edge, start, end, colour in zip(shape.edge, shape.start, shape.end, rgba, strict=True):
        if edge < 0 or colour[3] == 0:
            continue
        line = ribbons.stretch(network.polyline(edge), float(start), float(end))
        left, right = lane(site, int(edge))
        inset = 0.06 * drawn_width(network, int(edge))
        meshes.append(mesh_of(ribbons.ribbon(line, left - inset, right + inset, 0.06), colour[:3]))
    if meshes:
        stream.static(path, mesh3d(join(meshes)))
    return _legend(stream, path, shape.label, scale, extent)


def _legend(stream: Stream, path: str, label: str, scale: Scale, extent: Extent) -> str:
    """A colour bar on the floor south of the site, its ends labelled, and the same in words."""
    x0, y0, x1, _ = extent
    span = max(x1 - x0, 10.0)
    thick = 0.022 * span
    y = y0 - 0.05 * span
    xs = np.linspace(x0, x0 + 0.5 * span, 65)
    colours = screen_colours(scale.at((np.arange(64) + 0.5) / 64), scale)[:, :3]
    cells = [
        mesh_of(ribbons.ribbon(np.array([[a, y, 0.0], [b, y, 0.0]]), thick / 2, -thick / 2, 0.05), colour)
        for a, b, colour in zip(xs[:-1], xs[1:], colours, strict=True)
    ]
    stream.static(f"{path}/scale", mesh3d(join(cells)))
    top = ("≥ " if scale.clipped else "") + _short(scale.high)
    texts = [_short(scale.low), _short(float(scale.at(np.array(0.5)))), f"{top}  {label}"]
    ends = rr.Points3D(
        [[x, y - thick, 0.1] for x in xs[[0, 32, 64]]],
        labels=texts, radii=rr.Radius.ui_points(0.5), colors=[(225, 228, 235)], show_labels=True,
    )  # fmt: skip
    stream.static(f"{path}/scale/ends", ends)
    how = "blue below zero, orange above" if scale.diverging else "dark is low, bright is high"
    return f"**{label}**: {_short(scale.low)} to {top} ({how})"


def _log_marks(stream: Stream, path: str, marks: Marks) -> str:
    if not len(marks.xy):
        return ""
    colour = MARK_COLOURS[marks.kind]
    solid = marks.kind == "charger"
    pads = [
        mesh_of(ribbons.disc(x, y, float(r), 0.09, inner=0.0 if solid else 0.82 * float(r)), colour)
        for (x, y), r in zip(marks.xy, np.maximum(marks.size, 0.5), strict=True)
    ]
    stream.static(f"{path}/rings", mesh3d(join(pads)))
    where = np.column_stack([marks.xy, np.full(len(marks.xy), 0.2)])
    points = rr.Points3D(
        where,
        radii=rr.Radius.ui_points(3.0),
        colors=[colour],
        labels=list(marks.labels),
        show_labels=len(where) <= 30,
    )
    stream.static(f"{path}/labels", points)
    return ""


def _log_flows(stream: Stream, path: str, flows: Flows) -> str:
    """Arcs with heads, the wider the more."""
    ends = [np.column_stack([e, np.full(len(e), 0.3)]) for e in (flows.start, flows.end)]
    arcs = [arc(a, b) for a, b in zip(*ends, strict=True)]
    if not arcs:
        return ""
    width = 0.5 + 2.5 * np.tile(flows.weight / flows.weight.max(), 2) ** 2
    strips = rr.LineStrips3D(
        [*arcs, *map(head, arcs)], radii=rr.Radius.ui_points(width), colors=[palette.CALM]
    )
    stream.static(path, strips)
    return f"**{_title(flows.name)}**: the widest arrow is {_short(flows.weight.max())} {flows.label}"


def _log_lines(stream: Stream, path: str, shape: MovingLines) -> str:
    """Segments and the dots at their ends, in chunks of whole steps."""
    lengths = np.array([len(s) for s in shape.lines], np.int64)
    strips = np.concatenate(
        [np.asarray(s, float).reshape(-1, 2, 2) for s in shape.lines] or [np.zeros((0, 2, 2))]
    )
    strips = np.concatenate([strips, np.full((*strips.shape[:2], 1), 1.2)], axis=2).astype(np.float32)
    flags = np.concatenate([np.asarray(f, bool) for f in shape.critical] or [np.zeros(0, bool)])
    colours = np.where(flags[:, None], palette.CRITICAL, palette.CALM).astype(np.uint8)
    stream.static(path, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.2)))
    stream.parts(
        path,
        shape.time,
        lengths,
        lambda rows: rr.LineStrips3D.columns(strips=strips[rows], colors=colours[rows]),
    )
    dots, tints = strips.reshape(-1, 3), np.repeat(colours, 2, axis=0)
    stream.static(f"{path}/trucks", rr.Points3D.from_fields(radii=rr.Radius.ui_points(5.0)))
    stream.parts(
        f"{path}/trucks", shape.time, 2 * lengths,
        lambda rows: rr.Points3D.columns(positions=dots[rows], colors=tints[rows]),
    )  # fmt: skip
    return f"**{_title(shape.name)}**: lines join trucks of one cluster, red where it is critical"


def _log_series(stream: Stream, shape: Series) -> str:
    if not shape.over_time:
        return f"**{_title(shape.name)}** ({shape.y_label} over {shape.x_label}) is in the picture"
    for i, (name, values) in enumerate(shape.y.items()):
        path = entity("curves", shape.name, name)
        stream.static(path, curve_style(name.replace("_", " "), SERIES_COLOURS[i % 24]))
        log_curve(stream, path, *with_gaps(shape.x, np.asarray(values, float), thin.gap_limit(shape.x), None))
    return ""


def _bars_text(bars: Bars) -> str:
    rows = "\n".join(
        f"| {name} | {_short(value)} |"
        for name, value in zip(bars.labels[:20], bars.values[:20], strict=True)
    )
    return f"| {_title(bars.name)} | {bars.label} |\n| --- | --- |\n{rows}\n"


def _log_answer(stream: Stream, result: Result, legends: list[str]) -> None:
    answer = "\n".join(f"- {verbatim(line)}" for line in result.lines)
    text = f"### {_title(result.name)}\n\n{answer}\n\n" + "\n\n".join(legends)
    stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def _short(value: float) -> str:
    """Three digits, and no powers of ten where they can be helped."""
    return f"{value:,.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _contents(layer: Grid | EdgeValues | None) -> list[str]:
    """Heat lies under the rims and arrows of the roads, and takes the place of their surface."""
    surface = ["- /site/roads/surface/**"] if isinstance(layer, Grid) else []
    return [*surface, *([f"{entity('result', layer.name)}/**"] if layer is not None else [])]


def _own(marks: list[Marks], layer: Grid | EdgeValues | None) -> list[str]:
    """The marks that belong to one map only."""
    return [f"{entity('result', s.name)}/**" for s in marks if layer is not None and s.on == layer.name]


def _duration(result: Result) -> float:
    """From the first to the last time of what moves [s]."""
    times = [s.time for s in result.shapes if isinstance(s, MovingLines)]
    times += [np.asarray(s.x) for s in result.shapes if isinstance(s, Series) and s.over_time]
    known = [t for t in times if len(t)]
    return float(max(t[-1] for t in known) - min(t[0] for t in known)) * 1e-6 if known else 0.0


def _curve_title(series: Series) -> str:
    unit = series.y_label[series.y_label.find("[") + 1 :].rstrip("]")
    return f"{_title(series.name)} [{unit}]"


def _screen(result: Result, outline: Floats) -> rrb.Blueprint:
    """One plan a map; beside them the curves and the answer."""
    maps: list[Grid | EdgeValues | None] = [
        *[s for s in result.shapes if isinstance(s, Grid | EdgeValues)][:MAX_MAPS]
    ]
    marks = [s for s in result.shapes if isinstance(s, Marks)]
    always = [f"{entity('result', s.name)}/**" for s in result.shapes if isinstance(s, MovingLines | Flows)]
    always += [f"{entity('result', s.name)}/**" for s in marks if s.on is None]
    if maps:
        x0, y0, x1, _ = around(outline)
        outline = np.vstack([outline, [x0, y0 - 0.08 * (x1 - x0), 0.0]])  # the colour bar
    screen = blueprint.Screen(outline, (), duration=_duration(result))
    eye = blueprint.top_down(outline, WIDE)
    flat = [*always, *blueprint.FLAT, "- /site/zones/**"]
    plans: list[Any] = [
        blueprint.floor_view(
            screen, "Plan" if m is None else _title(m.name), eye, [*flat, *_contents(m), *_own(marks, m)]
        )
        for m in (maps or [None])
        if len(outline)
    ]
    if len(plans) == 1:
        only = maps[0] if maps else None
        over = [*always, *_contents(only), *_own(marks, only), "- /site/buildings/roofs/**"]
        plans.append(blueprint.floor_view(screen, "Site", blueprint.oblique(outline, WIDE), over))
    curves = [s for s in result.shapes if isinstance(s, Series) and s.over_time]
    side: list[Any] = [
        rrb.TimeSeriesView(
            origin="/",
            contents=[f"{entity('curves', s.name)}/**"],
            name=_curve_title(s),
            axis_x=blueprint.whole_time(),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=1 < len(s.y) <= 8),
        )
        for s in curves[:3]
    ]
    side.append(rrb.TextDocumentView(origin="/summary", name="Answer"))
    # Without a map and without places there is nothing to see from above.
    left = [rrb.Vertical(*plans) if len(plans) <= 2 else rrb.Grid(*plans)] if plans else []
    return rrb.Blueprint(
        rrb.Horizontal(*left, rrb.Vertical(*side), column_shares=[5, 3][-1 - len(left) :]),
        *blueprint.panels(screen),
        auto_views=False,
        auto_layout=False,
    )
