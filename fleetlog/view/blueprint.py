"""What is on the screen when a recording opens: plan, oblique view, map, curves and summary, without a click."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fleetlog.view.extent import Extent
from fleetlog.view.stream import TIMELINE, Stream

WINDOW = (240.0, 60.0)
"""What the plots of a long recording show before and after the cursor [s]."""
CURVE_NAMES = {"speed": "Speed [m/s]", "power": "Battery power [kW]", "soc": "State of charge [%]"}


@dataclass
class Screen:
    """What a recording has, from which its views follow."""

    extent: Extent
    prefixes: tuple[str, ...] = ("",)
    signals: set[str] = field(default_factory=set)
    trails: list[str] = field(default_factory=list)
    on_earth: bool = False
    legend: bool = True
    summary: str = "/summary"
    trail_seconds: float = 40.0
    start: int | None = None
    duration: float = 0.0


def window(before: float, after: float) -> rrb.TimeAxis:
    """A time axis that follows the cursor [s]."""
    start = rrb.TimeRangeBoundary.cursor_relative(seconds=-before)
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=start, end=rrb.TimeRangeBoundary.cursor_relative(seconds=after))
    )


def top_down(extent: Extent, aspect: float = 1.5) -> rrb.EyeControls3D:
    """An eye straight above the site, north up, that sees all of ``extent``."""
    x0, y0, x1, y1 = extent
    reach = max(y1 - y0, (x1 - x0) / aspect, 10.0) * 1.12
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    return rrb.EyeControls3D(
        position=(middle[0], middle[1] - 0.01, reach / (2 * np.tan(np.radians(27.5)))),
        look_target=(*middle, 0.0),
        eye_up=(0.0, 1.0, 0.0),
    )


def oblique(extent: Extent) -> rrb.EyeControls3D:
    """An eye south-east of the site and above it."""
    x0, y0, x1, y1 = extent
    size = max(np.hypot(x1 - x0, y1 - y0), 15.0)
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return rrb.EyeControls3D(
        position=(x + 0.25 * size, y - 0.60 * size, 0.49 * size),
        look_target=(x, y - 0.10 * size, 0.0),
        eye_up=(0.0, 0.0, 1.0),
    )


def trailing(paths: Iterable[str], seconds: float) -> dict[str, Any]:
    """Overrides that show the last ``seconds`` of each of these entities."""
    span = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return dict.fromkeys(paths, span)


def floor_view(
    screen: Screen, name: str, eye: rrb.EyeControls3D, contents: Sequence[str] = ()
) -> rrb.Spatial3DView:
    """A view of the site's floor with its trucks."""
    fleet = [f"{p}/{kind}/**" for p in screen.prefixes for kind in ("trucks", "trail")]
    return rrb.Spatial3DView(
        origin="/",
        name=name,
        contents=["/site/**", *fleet, *contents],
        overrides=trailing(screen.trails, screen.trail_seconds),
        eye_controls=eye,
        background=rrb.Background(color=[18, 20, 24]),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def around_cursor(before: float, after: float) -> rrb.VisibleTimeRanges:
    """What a plot reads: no more than its window, so that a long recording stays quick [s]."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-before),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=after),
    )


def whole_time() -> rrb.TimeAxis:
    """A time axis from the first to the last value."""
    ever = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))


def _legend_signal(screen: Screen) -> str:
    """The one plot that says which colour is which vehicle."""
    return next((s for s in ("soc", "speed", "power") if s in screen.signals), "")


def curve_view(screen: Screen, signal: str) -> rrb.TimeSeriesView:
    """The curves of one signal, all vehicles."""
    soc = signal == "soc"
    whole = soc or screen.duration <= 900
    return rrb.TimeSeriesView(
        origin="/",
        name=CURVE_NAMES.get(signal, signal),
        contents=[f"{p}/{signal}/**" for p in screen.prefixes],
        axis_y=rrb.ScalarAxis(range=(0.0, 104.0)) if soc else None,
        axis_x=whole_time() if whole else window(*WINDOW),
        time_ranges=None if whole else around_cursor(*WINDOW),
        plot_legend=rrb.PlotLegend(
            rrb.Corner2D.LeftBottom, visible=screen.legend and signal == _legend_signal(screen)
        ),
    )


def map_view(screen: Screen, latitude: float) -> rrb.MapView:
    """The trucks on the map, zoomed to the site."""
    x0, y0, x1, y1 = screen.extent
    span = max(x1 - x0, y1 - y0, 20.0)
    zoom = np.log2(156_543.0 * np.cos(np.radians(latitude)) * 380.0 / span)
    contents = ["/geo/**", *(f"{p}/geo/**" for p in screen.prefixes)]
    return rrb.MapView(origin="/", name="Map", contents=contents, zoom=float(np.clip(zoom, 2, 19)))


def panels(screen: Screen) -> list[Any]:
    """Time at the bottom, playing; nothing else beside the views."""
    speed = 1.0 if screen.duration < 60 else 4.0 if screen.duration < 600 else 10.0
    return [
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, playback_speed=speed, play_state="playing", loop_mode="all"
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    ]


def replay(screen: Screen, latitude: float | None) -> rrb.Blueprint:
    """The screen of a replay."""
    left: list[Any] = [floor_view(screen, "Site", oblique(screen.extent))]
    below: list[Any] = [floor_view(screen, "Plan", top_down(screen.extent))]
    if screen.on_earth and latitude is not None:
        below.append(map_view(screen, latitude))
    left.append(rrb.Horizontal(*below, column_shares=[3, 2][: len(below)]))
    right: list[Any] = [curve_view(screen, s) for s in CURVE_NAMES if s in screen.signals]
    right.append(rrb.TextDocumentView(origin=screen.summary, name="Summary"))
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*left, row_shares=[3, 2]), rrb.Vertical(*right), column_shares=[5, 3]),
        *panels(screen),
        auto_views=False,
        auto_layout=False,
    )


def send(stream: Stream, blueprint: rrb.Blueprint) -> None:
    """Make it the recording's own screen."""
    stream.recording.send_blueprint(blueprint, make_active=True, make_default=True)
