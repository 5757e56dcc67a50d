"""What is on the screen when a recording opens: plan, oblique view, map, curves and summary."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from fleetlog.core.arrays import Floats
from fleetlog.view.clock import around
from fleetlog.view.stream import TIMELINE, Stream

FIELD_OF_VIEW = np.radians(55.0)  # Of the viewer's eye, in height
ASPECT = 1.9  # Width by height of a view of the floor in a window of 16:9
LONG, WINDOW = 900.0, (-240.0, 60.0)  # From this duration on plots show a window about the cursor [s]
# Height of all plots, of one but its legend, of a name there [points].
COLUMN, FRAME, NAME = 815.0, 90.0, 23.0
# Shares of a plot that is high for its legend; where that is not enough, names stand at the trucks.
MOST = 2.5
PLOT, LEGEND, LETTER = 583.0, 58.0, 5.4  # Width of a plot, a legend without its words, a letter [points]
CURVE_NAMES = {"speed": "Speed [m/s]", "power": "Battery power [kW]", "soc": "State of charge [%]"}
TRAIL = 40.0  # Of the way behind a truck so much is shown [s]
NO_LEGEND = "Open tasks (dark: being fetched, light: on the forks)"
"""Title where there is no room for a legend in the plot."""
ON_FLOOR = ("trucks", "trail", "tasks", "reserved", "charging")  # What a fleet has on the floor
FLAT = tuple(f"- /site/buildings/{part}/**" for part in ("roofs", "walls", "frames"))
"""What a plan leaves out: all of a building but its outline."""


@dataclass
class Screen:
    """What a recording has, from which its views follow; ``timeline`` is the one that is played."""

    outline: Floats
    prefixes: tuple[str, ...] = ("",)
    signals: set[str] = field(default_factory=set)
    trails: list[str] = field(default_factory=list)
    legend: bool = True
    names: tuple[str, ...] = ()  # In the legend
    lanes: int = 0  # Trucks that have a lane of their states
    start: int | None = None
    duration: float = 0.0
    timeline: str = TIMELINE

    def paths(self, *signals: str) -> list[str]:
        """What the fleets have of some signals, as contents of a view."""
        return [f"{prefix}/{signal}/**" for prefix in self.prefixes for signal in signals]


def ranges(screen: Screen, first: float, last: float) -> rrb.VisibleTimeRanges:
    """From ``first`` to ``last`` [s] about the cursor, on each of the timelines."""
    start, end = (rrb.TimeRangeBoundary.cursor_relative(seconds=s) for s in (first, last))
    lines = dict.fromkeys((screen.timeline, TIMELINE))
    return rrb.VisibleTimeRanges([rr.VisibleTimeRange(timeline=t, start=start, end=end) for t in lines])


def fitted(outline: Floats, azimuth: float, elevation: float, aspect: float) -> tuple[Floats, Floats]:
    """Position and target of an eye that sees all of ``outline`` ((N, 3) m), filling the view but for a rim.

    ``azimuth`` [rad] is how far east of south it stands, ``elevation`` [rad] how high.  With its axes right,
    up and forward, an eye at e sees a point p when |(p - e).right| <= tan(half width) (p - e).forward, and
    likewise in height: four planes bound where it may be, and it is in their middle, as near as it can be."""
    if not len(outline):
        outline = np.array([[-10.0, -10.0, 0.0], [10.0, 10.0, 0.0]])
    rim = max(0.03 * float(np.ptp(outline[:, :2], axis=0).max()), 3.0)
    steps = np.array([[-rim, 0, 0], [rim, 0, 0], [0, -rim, 0], [0, rim, 0], [0, 0, 2.0]])
    points = (outline[:, None, :] + steps).reshape(-1, 3)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    south = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    forward = -np.cos(elevation) * south - np.array([0.0, 0.0, np.sin(elevation)])
    eye, depth, tall = np.zeros(3), np.inf, np.tan(FIELD_OF_VIEW / 2.0)
    for axis, tangent in ((right, tall * aspect), (np.cross(right, forward), tall)):
        high, low = (np.max(points @ (s * axis - tangent * forward)) for s in (1.0, -1.0))
        eye += 0.5 * (high - low) * axis
        depth = min(depth, -0.5 * (high + low) / tangent)
    eye += depth * forward
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    return eye, eye + ((middle - eye) @ forward) * forward


def floor_view(
    screen: Screen, name: str, contents: Sequence[str] = (), *, plan: bool = False, aspect: float = ASPECT
) -> rrb.Spatial3DView:
    """The floor with its trucks, all in view, obliquely or as a ``plan``; ``aspect``: width by height."""
    if plan:
        eye = fitted(screen.outline * np.array([1.0, 1.0, 0.0]), 0.0, np.pi / 2 - 1e-3, aspect)
    else:
        eye = fitted(screen.outline, np.radians(24.0), np.radians(42.0), aspect)
    up = (0.0, 1.0, 0.0) if plan else (0.0, 0.0, 1.0)
    return rrb.Spatial3DView(
        origin="/", name=name, contents=["/site/**", *screen.paths(*ON_FLOOR), *contents],
        overrides=dict.fromkeys(screen.trails, ranges(screen, -TRAIL, 0.0)),
        eye_controls=rrb.EyeControls3D(position=eye[0], look_target=eye[1], eye_up=up),
        background=rrb.Background(color=[18, 20, 24]), line_grid=rrb.LineGrid3D(visible=False),
    )  # fmt: skip


def time_of(screen: Screen, slow: bool, names: Sequence[str] = ()) -> dict[str, Any]:
    """Options of a plot: all time of a slow signal or short recording, else a window: it reads no more.
    The viewer draws the legend on the curves: the time begins earlier to make room for that of ``names``."""
    if slow or screen.duration <= LONG:
        start = end = rrb.TimeRangeBoundary.infinite()
        if names and screen.start is not None and screen.timeline == TIMELINE:
            share, first = (LEGEND + LETTER * max(map(len, names))) / PLOT, screen.start * 1e-6
            edges = first - share / (1.0 - share) * screen.duration, first + screen.duration
            start, end = (rrb.TimeRangeBoundary.absolute(seconds=edge) for edge in edges)
        return {"axis_x": rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end))}
    before, after = (rrb.TimeRangeBoundary.cursor_relative(seconds=s) for s in WINDOW)
    axis = rrb.TimeAxis(view_range=rr.TimeRange(start=before, end=after))
    return {"axis_x": axis, "time_ranges": ranges(screen, *WINDOW)}


def plot(
    name: str, contents: list[str], legend: bool, corner: rrb.Corner2D | None = None, **options: Any
) -> rrb.TimeSeriesView:
    """Curves over time."""
    key = rrb.PlotLegend(corner, visible=legend)
    return rrb.TimeSeriesView(origin="/", name=name, contents=contents, plot_legend=key, **options)


def curve_views(screen: Screen) -> list[Any]:
    """The curves of each signal, all vehicles; one plot says which colour is which vehicle."""
    told = next((s for s in ("soc", "speed", "power") if s in screen.signals), "")
    return [
        plot(
            title, screen.paths(signal), screen.legend and signal == told, rrb.Corner2D.LeftBottom,
            axis_y=rrb.ScalarAxis(range=(0.0, 104.0)) if signal == "soc" else None,
            **time_of(screen, signal == "soc", screen.names if screen.legend and signal == told else ()),
        )
        for signal, title in CURVE_NAMES.items()
        if signal in screen.signals
    ]  # fmt: skip


def activity_views(screen: Screen, roomy: bool = False) -> list[Any]:
    """Lanes of states or trucks by activity, open tasks by stage, if known; with legends where ``roomy``."""
    out: list[Any] = []
    legend = roomy or not screen.lanes
    titles = {"activity": "Trucks by activity", "open": "Open tasks" if legend else NO_LEGEND}
    if "state" in screen.signals:
        options = time_of(screen, slow=False)
        options["time_view"] = options.pop("axis_x")
        states = screen.paths("state")
        out.append(rrb.StateTimelineView(origin="/", name="Activities", contents=states, **options))
        del titles["activity"]
    corner, when = rrb.Corner2D.LeftTop, time_of(screen, slow=True)
    drawn = [(k, title) for k, title in titles.items() if k in screen.signals]
    return out + [plot(title, screen.paths(k), legend, corner, **when) for k, title in drawn]


def send(stream: Stream, screen: Screen, columns: list[Any], shares: Sequence[float]) -> None:
    """Make columns side by side the recording's own screen; time below, playing, where anything has one."""
    state = "collapsed" if screen.duration else "hidden"
    speed = 1.0 if screen.duration < 60 else 4.0 if screen.duration < 600 else 10.0
    time = rrb.TimePanel(
        state=state, timeline=screen.timeline, playback_speed=speed, play_state="playing", loop_mode="all"
    )
    hidden = rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden")
    row = rrb.Horizontal(*columns, column_shares=shares)
    whole = rrb.Blueprint(row, time, *hidden, auto_views=False, auto_layout=False)
    stream.recording.send_blueprint(whole, make_active=True, make_default=True)


def replay(stream: Stream, screen: Screen, latitude: float | None) -> None:
    """Send the screen of a replay; ``latitude`` of the site where it is known."""
    aspect = 1.7 * ASPECT if latitude is None else ASPECT
    below: list[Any] = [floor_view(screen, "Plan", FLAT, plan=True, aspect=aspect)]
    if latitude is not None:
        x0, y0, x1, y1 = around(screen.outline)
        # A tile of 256 points shows the equator at zoom 0; the map has about 340 by 240 points.
        metres_a_point = max((x1 - x0) / 340.0, (y1 - y0) / 240.0, 0.06) * 1.1
        zoom = float(np.clip(np.log2(156_543.0 * np.cos(np.radians(latitude)) / metres_a_point), 2, 19))
        contents = ["/geo/**", *screen.paths("geo")]
        below.append(rrb.MapView(origin="/", name="Map", contents=contents, zoom=zoom))
    doing = activity_views(screen)
    first = min(screen.lanes / 2.4, 4.0) if screen.lanes else 1.7 if doing else 1.0
    curves = curve_views(screen)
    right = [*doing, *curves]
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    if doing and len(below) > 1:
        # Activities take the summary's place, and it shares that of the map.
        below[1] = rrb.Tabs(below[1], summary)
    else:
        right.append(summary)
    shares = [first, *[1.0] * (len(right) - 1)]
    if curves and screen.legend:
        # The plot with the legend is as high as its names need: the viewer cuts off what does not fit.
        told = len(doing) + (len(curves) - 1 if "soc" in screen.signals else 0)
        need = min(FRAME + NAME * len(screen.names), COLUMN - 1.0)
        high = need / (COLUMN - need) * (sum(shares) - shares[told])
        screen.legend = high <= MOST
        shares[told] = max(high, 1.0) if screen.legend else 1.0
        right[len(doing) : len(doing) + len(curves)] = curve_views(screen)
    plans = rrb.Horizontal(*below, column_shares=[3, 2][: len(below)])
    site = rrb.Vertical(floor_view(screen, "Site"), plans, row_shares=[3, 2])
    columns = [site, rrb.Vertical(*right, row_shares=shares)]
    send(stream, screen, columns, [5, 3])
