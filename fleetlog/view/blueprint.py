"""What is on the screen when a recording opens: plan, oblique view, map, curves and summary."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fleetlog.core.trajectory import Floats
from fleetlog.view.extent import around
from fleetlog.view.stream import TIMELINE, Stream

Point = tuple[float, float, float]
FIELD_OF_VIEW = np.radians(55.0)
"""Of the viewer's eye, in height."""
ASPECT = 1.9
"""Width by height of a view of the floor in a window of 16:9."""
LONG, WINDOW = 900.0, (240.0, 60.0)
"""From what duration on plots show a window only, and what it holds before and after the cursor [s]."""
CURVE_NAMES = {"speed": "Speed [m/s]", "power": "Battery power [kW]", "soc": "State of charge [%]"}


@dataclass
class Screen:
    """What a recording has, from which its views follow."""

    outline: Floats
    prefixes: tuple[str, ...] = ("",)
    signals: set[str] = field(default_factory=set)
    trails: list[str] = field(default_factory=list)
    on_earth: bool = False
    legend: bool = True
    lanes: int = 0
    """Trucks that have a lane of their states."""
    summary: str = "/summary"
    trail_seconds: float = 40.0
    start: int | None = None
    duration: float = 0.0
    timeline: str = TIMELINE
    """The one that is played."""


def cursor(before: float, after: float) -> dict[str, rrb.TimeRangeBoundary]:
    """From so many seconds before the cursor to so many after it."""
    relative = rrb.TimeRangeBoundary.cursor_relative
    return {"start": relative(seconds=-before), "end": relative(seconds=after)}


def ranges(screen: Screen, before: float, after: float) -> rrb.VisibleTimeRanges:
    """So much about the cursor, on each of the timelines [s]."""
    span = cursor(before, after)
    lines = dict.fromkeys((screen.timeline, TIMELINE))
    return rrb.VisibleTimeRanges([rr.VisibleTimeRange(timeline=line, **span) for line in lines])


def top_down(outline: Floats, aspect: float = ASPECT) -> rrb.EyeControls3D:
    """An eye straight above the site, north up, that sees all; ``aspect`` is the view's width by height."""
    flat = outline * np.array([1.0, 1.0, 0.0])
    position, target = fitted(flat, 0.0, np.pi / 2 - 1e-3, aspect)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 1.0, 0.0))


def oblique(outline: Floats, aspect: float = ASPECT) -> rrb.EyeControls3D:
    """An eye south-south-east of the site and above it that sees all of ``outline``."""
    position, target = fitted(outline, np.radians(24.0), np.radians(42.0), aspect)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 0.0, 1.0))


def fitted(outline: Floats, azimuth: float, elevation: float, aspect: float) -> tuple[Point, Point]:
    """Position and target of an eye that sees all of ``outline`` ((N, 3) m), filling the view but for a rim.

    ``azimuth`` [rad] is how far east of south it stands, ``elevation`` [rad] how high.  For a point p about
    the target, with the eye's axes right, up and forward, the eye at distance d sees it when |p.right| <= (d
    + p.forward) tan(half width), and likewise in height; the target is moved until what is seen is in the
    middle.
    """
    if not len(outline):
        outline = np.array([[-10.0, -10.0, 0.0], [10.0, 10.0, 0.0]])
    rim = max(0.03 * float(np.ptp(outline[:, :2], axis=0).max()), 3.0)
    steps = np.array([[-rim, 0, 0], [rim, 0, 0], [0, -rim, 0], [0, rim, 0], [0, 0, 2.0]])
    points = (outline[:, None, :] + steps).reshape(-1, 3)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    south = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    forward = -np.cos(elevation) * south - np.array([0.0, 0.0, np.sin(elevation)])
    up = np.cross(right, forward)
    tall = np.tan(FIELD_OF_VIEW / 2.0)
    target = (points.min(axis=0) + points.max(axis=0)) / 2.0

    def seen() -> tuple[float, Floats, Floats]:
        p = points - target
        across, above, ahead = p @ right, p @ up, p @ forward
        far = float(np.max([np.abs(across) / (tall * aspect) - ahead, np.abs(above) / tall - ahead]))
        return far, across / (far + ahead), above / (far + ahead)

    for _ in range(12):
        distance, sideways, upward = seen()
        middle = (sideways.min() + sideways.max()) * right + (upward.min() + upward.max()) * up
        target = target + 0.5 * distance * middle
    distance, *_ = seen()
    x, y, z = (target - distance * forward).tolist()
    u, v, w = target.tolist()
    return (x, y, z), (u, v, w)


NO_LEGEND = "Open tasks (dark: being fetched, light: on the forks)"
"""Title where there is no room for a legend in the plot."""
ON_FLOOR = ("trucks", "trail", "tasks", "reserved", "charging")
"""What a fleet has on the floor."""
FLAT = tuple(f"- /site/buildings/{part}/**" for part in ("roofs", "walls", "frames"))
"""What a plan leaves out: all of a building but its outline."""


def floor_view(
    screen: Screen, name: str, eye: rrb.EyeControls3D, contents: Sequence[str] = ()
) -> rrb.Spatial3DView:
    """A view of the site's floor with its trucks; ``contents`` are further filters."""
    fleet = [f"{p}/{kind}/**" for p in screen.prefixes for kind in ON_FLOOR]
    behind = ranges(screen, screen.trail_seconds, 0.0)
    return rrb.Spatial3DView(
        origin="/", name=name, contents=["/site/**", *fleet, *contents],
        overrides=dict.fromkeys(screen.trails, behind), eye_controls=eye,
        background=rrb.Background(color=[18, 20, 24]), line_grid=rrb.LineGrid3D(visible=False),
    )  # fmt: skip


def whole_time() -> rrb.TimeAxis:
    """A time axis from the first to the last value."""
    ever = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))


def _legend_signal(screen: Screen) -> str:
    """The one plot that says which colour is which vehicle."""
    return next((s for s in ("soc", "speed", "power") if s in screen.signals), "")


def time_of(screen: Screen, slow: bool) -> dict[str, Any]:
    """Options of a plot: all of the time for a slow signal or a short recording, else a window.

    A plot of a window reads no more than that, so that a long recording stays quick.
    """
    if slow or screen.duration <= LONG:
        return {"axis_x": whole_time()}
    axis = rrb.TimeAxis(view_range=rr.TimeRange(**cursor(*WINDOW)))
    return {"axis_x": axis, "time_ranges": ranges(screen, *WINDOW)}


def plot(
    name: str, contents: list[str], legend: bool, corner: rrb.Corner2D | None = None, **options: Any
) -> rrb.TimeSeriesView:
    """Curves over time."""
    key = rrb.PlotLegend(corner, visible=legend)
    return rrb.TimeSeriesView(origin="/", name=name, contents=contents, plot_legend=key, **options)


def curve_view(screen: Screen, signal: str) -> rrb.TimeSeriesView:
    """The curves of one signal, all vehicles."""
    soc = signal == "soc"
    return plot(
        CURVE_NAMES.get(signal, signal), [f"{p}/{signal}/**" for p in screen.prefixes],
        screen.legend and signal == _legend_signal(screen), rrb.Corner2D.LeftBottom,
        axis_y=rrb.ScalarAxis(range=(0.0, 104.0)) if soc else None, **time_of(screen, slow=soc),
    )  # fmt: skip


def state_view(screen: Screen) -> rrb.StateTimelineView:
    """A lane of states for every truck."""
    options: dict[str, Any] = time_of(screen, slow=False)
    options["time_view"] = options.pop("axis_x")
    contents = [f"{p}/state/**" for p in screen.prefixes]
    return rrb.StateTimelineView(origin="/", name="Activities", contents=contents, **options)


def count_view(screen: Screen, signal: str, name: str, legend: bool) -> rrb.TimeSeriesView:
    """Trucks by activity, or tasks by stage: a curve each, named in the ``legend`` where there is room."""
    contents = [f"{p}/{signal}/**" for p in screen.prefixes]
    return plot(name, contents, legend, rrb.Corner2D.LeftTop, **time_of(screen, slow=True))


def activity_views(screen: Screen, roomy: bool = False) -> list[Any]:
    """What trucks do and what there is to do; nothing for a recording that does not say."""
    out: list[Any] = []
    legend = roomy or not screen.lanes
    if "state" in screen.signals:
        out.append(state_view(screen))
    elif "activity" in screen.signals:
        out.append(count_view(screen, "activity", "Trucks by activity", legend))
    if "open" in screen.signals:
        out.append(count_view(screen, "open", "Open tasks" if legend else NO_LEGEND, legend))
    return out


def map_view(screen: Screen, latitude: float) -> rrb.MapView:
    """The trucks on the map, zoomed to the site."""
    x0, y0, x1, y1 = around(screen.outline)
    # A tile of 256 points shows the equator at zoom 0; the map has about 340 by 240 points.
    metres_a_point = max((x1 - x0) / 340.0, (y1 - y0) / 240.0, 0.06) * 1.1
    zoom = np.log2(156_543.0 * np.cos(np.radians(latitude)) / metres_a_point)
    contents = ["/geo/**", *(f"{p}/geo/**" for p in screen.prefixes)]
    return rrb.MapView(origin="/", name="Map", contents=contents, zoom=float(np.clip(zoom, 2, 19)))


def whole(screen: Screen, columns: list[Any], shares: Sequence[float]) -> rrb.Blueprint:
    """Columns beside one another; time below, playing, where anything has a time; nothing else."""
    state = "collapsed" if screen.duration else "hidden"
    speed = 1.0 if screen.duration < 60 else 4.0 if screen.duration < 600 else 10.0
    time = rrb.TimePanel(
        state=state, timeline=screen.timeline, playback_speed=speed, play_state="playing", loop_mode="all"
    )
    hidden = rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden")
    row = rrb.Horizontal(*columns, column_shares=shares)
    return rrb.Blueprint(row, time, *hidden, auto_views=False, auto_layout=False)


def replay(screen: Screen, latitude: float | None) -> rrb.Blueprint:
    """The screen of a replay."""
    left: list[Any] = [floor_view(screen, "Site", oblique(screen.outline))]
    on_map = screen.on_earth and latitude is not None
    below: list[Any] = [
        floor_view(screen, "Plan", top_down(screen.outline, ASPECT if on_map else 1.7 * ASPECT), FLAT)
    ]
    if screen.on_earth and latitude is not None:
        below.append(map_view(screen, latitude))
    doing = activity_views(screen)
    right: list[Any] = [*doing, *(curve_view(screen, s) for s in CURVE_NAMES if s in screen.signals)]
    first = min(screen.lanes / 2.4, 4.0) if screen.lanes else 1.7 if doing else 1.0
    shares = [first, *[1.0] * (len(right) - 1)]
    summary = rrb.TextDocumentView(origin=screen.summary, name="Summary")
    if doing and len(below) > 1:
        # Activities take the summary's place, and it shares that of the map.
        below[1] = rrb.Tabs(below[1], summary)
    else:
        right, shares = [*right, summary], [*shares, 1.0]
    left.append(rrb.Horizontal(*below, column_shares=[3, 2][: len(below)]))
    columns = [rrb.Vertical(*left, row_shares=[3, 2]), rrb.Vertical(*right, row_shares=shares)]
    return whole(screen, columns, [5, 3])


def send(stream: Stream, blueprint: rrb.Blueprint) -> None:
    """Make it the recording's own screen."""
    stream.recording.send_blueprint(blueprint, make_active=True, make_default=True)
