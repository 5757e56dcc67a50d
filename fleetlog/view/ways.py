"""Where a site has no map: the ways driven, as thin lines on the floor and on the street map."""

from __future__ import annotations

import numpy as np
import rerun as rr

from fleetlog.core.site import Site
from fleetlog.core.trajectory import Floats, Trajectory
from fleetlog.view import palette, thin
from fleetlog.view.stream import Stream, entity, ui_points

POINTS_A_DAY = 4000
BREAK = 200.0
"""A step longer than this [m] is a jump of the log, not a way."""


def ways_of(t: Trajectory) -> list[Floats]:
    """Polylines (n, 2) of one day [m], broken at gaps and jumps, of at most some thousand points."""
    xy = np.column_stack([t.floats("x"), t.floats("y")])
    known = np.isfinite(xy).all(axis=1)
    xy, time = xy[known], t.time[known]
    if len(xy) < 2:
        return []
    step = np.hypot(*np.diff(xy, axis=0).T)
    cuts = np.flatnonzero((np.diff(time) > thin.gap_limit(time)) | (step > BREAK)) + 1
    every = max(1, len(xy) // POINTS_A_DAY)
    pieces = [p[np.unique(np.append(np.arange(0, len(p), every), len(p) - 1))] for p in np.split(xy, cuts)]
    return [p for p in pieces if len(p) > 1]


def log_ways(
    stream: Stream, prefix: str, vehicle: str, colour: palette.Colour, ways: list[Floats], site: Site
) -> None:
    """Draw them dimmed, so that the truck and its trail stand out."""
    if not ways:
        return
    tint = [tuple(int(40 + 0.35 * c) for c in colour)]
    strips = [np.column_stack([w, np.zeros(len(w))]) for w in ways]
    lines = rr.LineStrips3D(strips, colors=tint, radii=ui_points(0.8))
    stream.static(entity("site", "driven", prefix, vehicle), lines)
    if site.frame is not None:
        on_earth = [np.column_stack(site.frame.to_geographic(*w.T)) for w in ways]
        drawn = rr.GeoLineStrings(lat_lon=on_earth, colors=tint * len(ways), radii=ui_points(1.0))
        stream.static(entity("geo", "driven", prefix, vehicle), drawn)
