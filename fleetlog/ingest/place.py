"""Positions into the site's frame, and the check that log and map lie in the same place."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fleetlog.core.network import Network
from fleetlog.core.site import Frame, MapFrame, Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.errors import DataError
from fleetlog.importers.base import GEOGRAPHIC

FAR = 3000.0  # A log whose middle lies farther from every road than this is of another place [m]


def place(rows: Trajectory, site: Site) -> Trajectory:
    """Rows with x, y [m] in the site's frame; geographic columns are turned into them, local ones stay.

    A log that has both keeps x, y where they agree with latitude and longitude to a metre (a dataset that
    comes back); else these are of another frame, kept as ``x_log``, ``y_log``: the geographic ones count."""
    if "latitude" not in rows or site.frame is None:
        return rows
    x, y = site.frame.to_local(rows.floats("latitude"), rows.floats("longitude"))
    x, y = (np.where(np.isfinite(v), v, np.nan) for v in (x, y))
    if "x" in rows and "y" in rows:
        own = rows.floats("x"), rows.floats("y")
        off = np.hypot(own[0] - x, own[1] - y)
        if not np.isfinite(off).any() or float(np.nanmedian(off)) < 1.0:
            x, y = (np.where(np.isfinite(o), o, v) for o, v in zip(own, (x, y), strict=True))
        else:
            rows = rows.with_columns(x_log=own[0], y_log=own[1])
    return rows.without("latitude", "longitude").with_columns(x=x, y=y)


def into_site(rows: Trajectory, frames: Sequence[MapFrame], every: MapFrame | None) -> Trajectory:
    """Rows whose x, y are in a frame of their own, in the site's. ``every`` is the frame of all rows; else
    that of the name in a row's ``map_id`` counts, and others stay. ``level`` is the floor of the frame."""
    if "x" not in rows or "y" not in rows:
        return rows
    maps = rows.labels("map_id")
    named = [(f, maps.codes == maps.names.index(f.name)) for f in frames if f.name in maps.names]
    for frame, mine in named if every is None else [(every, np.ones(len(rows), bool))]:
        x, y = frame.to_site(rows.floats("x"), rows.floats("y"))
        turned = np.remainder(rows.floats("heading") + frame.rotation + np.pi, 2.0 * np.pi) - np.pi
        new = {n: v for n, v in (("x", x), ("y", y), ("heading", turned)) if n in rows}
        rows = rows.with_columns(**{n: np.where(mine, v, rows.floats(n)) for n, v in new.items()})
        if frame.level:
            levels = zip(mine, rows.labels("level").strings(), strict=True)
            rows = rows.with_columns(level=Labels.of([frame.level if m else old for m, old in levels]))
    return rows


def check_place(rows: Trajectory, site: Site, sample: Trajectory) -> None:
    """:class:`DataError` where the log lies kilometres from the map; ``sample``: the rows as read."""
    if site.frame is not None and looks_like_degrees(sample):
        # x and y may be the longitude and latitude of the site, in whatever order
        for names in (GEOGRAPHIC[::-1], GEOGRAPHIC):
            about = [getattr(site.frame, name) for name in names]
            if np.abs(np.subtract(_middle(sample, "x", "y"), about)).max() < 0.5:
                do = f'map them in a profile: [columns] {names[0]} = "x", {names[1]} = "y"'
                raise DataError("the columns x and y hold degrees, not metres", do=do)
    if site.network is None:
        return
    away = _distance(_middle(rows, "x", "y"), site.network)
    if not away > FAR:
        return
    what = f"the log is about {away / 1000:,.0f} km from the map of site {site.name!r}"
    do = "check the site's frame and the log's coordinates"
    if "latitude" in sample and (frame := site.frame) is not None:
        a, b = _middle(sample, *GEOGRAPHIC)
        if abs(b) <= 90 and _distance(frame.to_local(b, a), site.network) <= FAR:
            do = "latitude and longitude are exchanged in the log; map them in a profile"
        what += f" (log at {a:.4f}, {b:.4f}; site at {frame.latitude:.4f}, {frame.longitude:.4f})"
    raise DataError(what, do=do)


def _middle(rows: Trajectory, *names: str) -> list[float]:
    """Medians of two columns, where both are known; NaN without such rows."""
    known = np.stack([rows.floats(name) for name in names])
    known = known[:, np.isfinite(known).all(axis=0)]
    return [float(np.median(values)) if len(values) else np.nan for values in known]


def _distance(place: Sequence[Any], network: Network) -> float:
    """Distance to the rectangle around the roads [m]; not finite where the place is not."""
    x, y = map(float, place)
    xmin, ymin, xmax, ymax = network.extent
    return float(np.hypot(max(xmin - x, 0.0, x - xmax), max(ymin - y, 0.0, y - ymax)))


def looks_like_degrees(rows: Trajectory) -> bool:
    """Whether columns called x and y hold degrees: figures that hardly change while the truck moves."""
    good = np.isfinite(rows.floats("x")) & np.isfinite(rows.floats("y"))
    if "latitude" in rows or good.sum() < 10:
        return False
    t, x, y, speed = (v[good] for v in (rows.seconds(), *(rows.floats(n) for n in ("x", "y", "speed"))))
    least, most = sorted((np.abs(x).max(), np.abs(y).max()))
    if most > 180.0 or least > 90.0:
        return False
    size = float(max(np.ptp(x), np.ptp(y)))
    driven = float(np.nansum(speed * np.minimum(np.diff(t, prepend=t[0]), 5.0)))
    if driven > 20.0:
        return size < driven / 1000.0
    fine = bool((np.abs(np.round(x, 4) - x) > 1e-9).mean() > 0.5)
    return fine and 0.0 < size < 0.5 and size < 0.1 * float(np.median(np.hypot(x, y)))


def with_frame(site: Site, rows: Trajectory) -> Site:
    """The site, with a frame from the data where it has none, no map, and the log is geographic. The frame is
    about the median of the first positions, rounded to about a metre."""
    if site.frame is not None or "latitude" not in rows or (site.network is not None and "x" in rows):
        return site
    if site.network is not None:
        what = f"the log is geographic and site {site.name!r} does not say where on earth it lies"
        raise DataError(what, do="add [frame] latitude and longitude to the site file")
    latitude, longitude = (rows.floats(name) for name in GEOGRAPHIC)
    first = np.flatnonzero((np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0))[:1000]
    if not len(first):
        return site
    origin = [round(float(np.median(degrees[first])), 5) for degrees in (latitude, longitude)]
    return replace(site, frame=Frame(origin[0], origin[1]))
