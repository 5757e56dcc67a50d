"""``recording.rrd`` of an analysis: its shapes on the site's floor, its curves and its answer in words."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fleetlog.core.arrays import levels
from fleetlog.core.result import Bars, EdgeValues, Flows, Grid, Marks, MovingLines, Result, Series, Shape
from fleetlog.core.site import Site
from fleetlog.simulate.track import stretch
from fleetlog.view import blueprint, clock, palette, ribbons
from fleetlog.view.clock import MINUTE, SKIPPED, Extent, around, shapes_outline, skipping
from fleetlog.view.fleet import curve_style, log_curve, with_gaps
from fleetlog.view.palette import Scale, scales_of, screen_colours
from fleetlog.view.scene import drawn_width, lane, log_site
from fleetlog.view.stream import Stream, entity, open_stream, ui_points, verbatim

MAX_MAPS = 9
WIDE = 2.5  # Width by height of one of two maps above one another


def write_result_recording(result: Result, site: Site, out_rrd: str | Path) -> Path:
    """The shapes of a result as an .rrd file, whole or not at all; bars and curves not over time in words."""
    outline = shapes_outline(result, site)
    extent = around(outline)
    moving = [s.time for s in result.shapes if isinstance(s, MovingLines)]
    curves = [s for s in result.shapes if isinstance(s, Series) and s.over_time]
    times = np.concatenate([np.zeros(0, np.int64), *moving, *(np.asarray(s.x) for s in curves)])
    clock = skipping(levels(times // MINUTE))
    with open_stream(Path(out_rrd), f"{site.name}, {result.name}") as stream:
        stream.clock = clock
        log_site(stream, site)
        scales = scales_of(result.shapes)
        texts = [_log_shape(stream, site, shape, extent, scales) for shape in result.shapes]
        periods = [] if clock is None else clock.lines()
        answer = "\n".join(f"- {line}" for line in [*map(verbatim, result.lines), *periods])
        text = "\n\n".join([f"### {_title(result.name)}", answer, *dict.fromkeys(t for t in texts if t)])
        stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        if not len(times):
            # A view of a recording without any time stays on "static"; one instant makes the timeline.
            stream.rows("/result/instant", np.zeros(1, np.int64), rr.Scalars, scalars=[0.0])
        screen = blueprint.Screen(outline, ())
        if len(times):
            screen.start, screen.duration = int(times.min()), float(np.ptp(times)) * 1e-6
        if clock is not None:
            screen.timeline, screen.duration = SKIPPED, clock.seconds
        _send_layout(stream, result, screen, curves[:3])
    return Path(out_rrd)


def _log_shape(stream: Stream, site: Site, shape: Shape, extent: Extent, scales: dict[str, Scale]) -> str:
    """Draw one shape; a line of Markdown that says how to read it."""
    path = entity("result", shape.name)
    match shape:
        case Grid():
            _log_grid(stream, path, shape, scales[shape.name])
            return _legend(stream, path, shape.label, scales[shape.name], extent)
        case EdgeValues() if site.network is not None:
            _log_edges(stream, path, shape, site, scales[shape.name])
            return _legend(stream, path, shape.label, scales[shape.name], extent)
        case MovingLines():
            _log_lines(stream, path, shape)
            return f"**{_title(shape.name)}**: lines join trucks of one cluster, red where it is critical"
        case Flows() if len(shape.weight):
            ends = [np.column_stack([e, np.full(len(e), 0.3)]) for e in (shape.start, shape.end)]
            arcs = [ribbons.arc(a, b) for a, b in zip(*ends, strict=True)]
            width = 0.5 + 2.5 * np.tile(shape.weight / shape.weight.max(), 2) ** 2
            lines = [*arcs, *map(ribbons.head, arcs)]
            stream.static(path, rr.LineStrips3D(lines, radii=ui_points(width), colors=[palette.CALM]))
            return f"**{_title(shape.name)}**: the widest arrow is {_short(shape.weight.max())} {shape.label}"
        case Bars():
            shown = zip(shape.labels[:20], shape.values[:20], strict=True)
            rows = "\n".join(f"| {name} | {_short(value)} |" for name, value in shown)
            return f"| {_title(shape.name)} | {shape.label} |\n| --- | --- |\n{rows}\n"
        case Series(over_time=False):
            return f"**{_title(shape.name)}** ({shape.y_label} over {shape.x_label}) is in the picture"
        case Series():
            for i, (name, values) in enumerate(shape.y.items()):
                style = curve_style(name.replace("_", " "), palette.vehicle_colour(i))
                curve = with_gaps(shape.x, np.asarray(values, float), clock.gap_limit(shape.x), None)
                log_curve(stream, entity("curves", shape.name, name), *curve, style)
        case Marks() if len(shape.xy):
            colour, hole = palette.RINGS[shape.kind], 0.0 if shape.kind == "charger" else 0.82
            spots = zip(shape.xy, np.maximum(shape.size, 0.5).tolist(), strict=True)
            pads = [(ribbons.disc(x, y, r, 0.09, inner=hole * r), colour) for (x, y), r in spots]
            stream.static(f"{path}/rings", ribbons.mesh3d(pads))
            where = np.column_stack([shape.xy, np.full(len(shape.xy), 0.2)])
            look: Any = {"radii": ui_points(3.0), "colors": [colour], "show_labels": len(where) <= 30}
            stream.static(f"{path}/labels", rr.Points3D(where, labels=list(shape.labels), **look))
            return f"**{'Rings' if hole else 'Discs'}**: {shape.name.replace('_', ' ')}"
    return ""


def _log_grid(stream: Stream, path: str, grid: Grid, scale: Scale) -> None:
    rgba = screen_colours(np.where(grid.values == 0.0, np.nan, grid.values), scale)
    if grid.mask is not None:
        rgba[..., 3] = np.where(grid.mask, rgba[..., 3], rgba[..., 3] // 5)
    height, width = rgba.shape[:2]
    form = rr.components.ImageFormat(width=width, height=height, color_model="RGBA", channel_datatype="U8")
    pixels, corner = np.ascontiguousarray(rgba[::-1]).tobytes(), [grid.x0, grid.y0, 0.0]
    where = {"cell_size": grid.cell, "translation": corner, "opacity": 0.9}
    stream.static(path, rr.GridMap(data=pixels, format=form, **where))


def _log_edges(stream: Stream, path: str, shape: EdgeValues, site: Site, scale: Scale) -> None:
    network, meshes = site.roads(), []
    colours = screen_colours(shape.values, scale)
    for edge, start, end, colour in zip(shape.edge.tolist(), shape.start, shape.end, colours, strict=True):
        if edge >= 0 and colour[3]:
            line = stretch(network.polyline(edge), float(start), float(end))
            left, right = lane(site, edge)
            inset = 0.06 * drawn_width(network, edge)
            meshes.append((ribbons.ribbon(line, left - inset, right + inset, 0.06), colour[:3]))
    if meshes:
        stream.static(path, ribbons.mesh3d(meshes))


def _legend(stream: Stream, path: str, label: str, scale: Scale, extent: Extent) -> str:
    """A colour bar on the floor south of the site, its ends labelled, and the same in words."""
    x0, y0, x1, _ = extent
    span = max(x1 - x0, 10.0)
    thick, y = 0.022 * span, y0 - 0.05 * span
    xs = np.linspace(x0, x0 + 0.5 * span, 65)
    colours = screen_colours(scale.at((np.arange(64) + 0.5) / 64), scale)[:, :3]
    cells = [
        (ribbons.ribbon(np.array([[a, y, 0.0], [b, y, 0.0]]), thick / 2, -thick / 2, 0.05), colour)
        for a, b, colour in zip(xs[:-1], xs[1:], colours, strict=True)
    ]
    stream.static(f"{path}/scale", ribbons.mesh3d(cells))
    top = ("≥ " if scale.clipped else "") + _short(scale.high)
    low = ("≤ " if scale.clipped and scale.diverging else "") + _short(scale.low)
    # What it shows stands beside the bar: below it a long label covers the numbers.
    spots = [*((x, y - thick) for x in xs[[0, 32, 64]]), (x0 + 0.78 * span, y + thick)]
    texts = [low, _short(float(scale.at(np.array(0.5)))), top, label]
    look: Any = {"radii": ui_points(0.5), "colors": [(225, 228, 235)], "show_labels": True}
    stream.static(f"{path}/scale/ends", rr.Points3D([[*spot, 0.1] for spot in spots], labels=texts, **look))
    how = "blue below zero, orange above" if scale.diverging else "dark is low, bright is high"
    return f"**{label}**: {low} to {top} ({how})"


def _log_lines(stream: Stream, path: str, shape: MovingLines) -> None:
    """Segments and the dots at their ends."""
    lengths = np.array([len(s) for s in shape.lines], np.int64)
    flat = np.concatenate([np.zeros((0, 2, 2)), *(np.reshape(s, (-1, 2, 2)) for s in shape.lines)])
    strips = np.pad(flat, ((0, 0), (0, 0), (0, 1)), constant_values=1.2).astype(np.float32)
    flags = np.concatenate([np.zeros(0, bool), *shape.critical]).astype(bool)
    colours = np.where(flags[:, None], palette.CRITICAL, palette.CALM).astype(np.uint8)
    stream.static(path, rr.LineStrips3D.from_fields(radii=ui_points(2.2)))
    stream.rows(path, shape.time, rr.LineStrips3D, lengths, strips=strips, colors=colours)
    dots, tints = strips.reshape(-1, 3), np.repeat(colours, 2, axis=0)
    stream.static(f"{path}/trucks", rr.Points3D.from_fields(radii=ui_points(5.0)))
    stream.rows(f"{path}/trucks", shape.time, rr.Points3D, 2 * lengths, positions=dots, colors=tints)


def _short(value: float) -> str:
    """Three digits, and no powers of ten where they can be helped."""
    return f"{value:,.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _send_layout(stream: Stream, result: Result, screen: blueprint.Screen, curves: list[Series]) -> None:
    """One plan a map; beside them the curves and the answer."""
    outline = screen.outline
    maps: list[Any] = [s for s in result.shapes if isinstance(s, Grid | EdgeValues)][:MAX_MAPS] or [None]
    if maps[0] is not None:
        x0, y0, x1, _ = around(outline)
        screen.outline = np.vstack([outline, [x0, y0 - 0.08 * (x1 - x0), 0.0]])  # the colour bar

    def view(layer: Grid | EdgeValues | None, name: str, plan: bool, *hidden: str) -> Any:
        """One map with all marks; heat takes the place of the roads' surface."""
        shown = [s.name for s in result.shapes if isinstance(s, MovingLines | Flows | Marks) or s is layer]
        surface = ["- /site/roads/surface/**"] if isinstance(layer, Grid) else []
        contents = [f"{entity('result', shape)}/**" for shape in shown]
        return blueprint.floor_view(screen, name, [*contents, *surface, *hidden], plan=plan, aspect=WIDE)

    flat = *blueprint.FLAT, "- /site/zones/**"
    # Without a map and without places there is nothing to see from above.
    plans = [view(m, _title(m.name) if m else "Plan", True, *flat) for m in maps if len(outline)]
    if len(plans) == 1:
        plans.append(view(maps[0], "Site", False, "- /site/buildings/roofs/**"))
    side: list[Any] = [
        blueprint.plot(
            f"{_title(s.name)} [{s.y_label[s.y_label.find('[') + 1 :].rstrip(']')}]",
            [f"{entity('curves', s.name)}/**"], 1 < len(s.y) <= 8, rrb.Corner2D.LeftTop,
            **blueprint.time_of(screen, slow=True, names=tuple(s.y) if 1 < len(s.y) <= 8 else ()),
        )
        for s in curves
    ]  # fmt: skip
    side.append(rrb.TextDocumentView(origin="/summary", name="Answer"))
    left = [rrb.Vertical(*plans) if len(plans) <= 2 else rrb.Grid(*plans)] if plans else []
    blueprint.send(stream, screen, [*left, rrb.Vertical(*side)], [5, 3][-1 - len(left) :])
