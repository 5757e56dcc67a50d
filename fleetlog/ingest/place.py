"""Positions into the site's frame, and the check that log and map lie in the same place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Frame, MapFrame, Site
from fleetlog.core.trajectory import Floats, Labels, Trajectory
from fleetlog.errors import DataError
from fleetlog.ingest.rows import without

NO_ROWS = 0.0005
"""A smaller share of rows on roads is shown as 0.0 %."""
FAR = 3000.0
"""A log whose middle lies farther from every road than this is of another place [m]."""


def frame_from(latitude: Floats, longitude: Floats) -> Frame | None:
    """A frame about the median of the first positions, rounded to about a metre; None without positions."""
    good = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0)
    if not good.any():
        return None
    first = np.flatnonzero(good)[:1000]
    return Frame(round(float(np.median(latitude[first])), 5), round(float(np.median(longitude[first])), 5))


def place(rows: Trajectory, site: Site) -> Trajectory:
    """Rows with x, y [m] in the site's frame; geographic columns are turned into them, local ones stay.

    A log that has both keeps its x, y where they agree with its latitude and longitude to a metre (a dataset
    that comes back); otherwise they are in another frame: the geographic ones count, and they are kept as
    ``x_log``, ``y_log``.
    """
    if "latitude" not in rows or site.frame is None:
        return rows
    x, y = site.frame.to_local(rows.floats("latitude"), rows.floats("longitude"))
    x, y = (np.where(np.isfinite(v), v, np.nan) for v in (x, y))
    if "x" in rows and "y" in rows:
        off = np.hypot(rows.floats("x") - x, rows.floats("y") - y)
        if not np.isfinite(off).any() or float(np.nanmedian(off)) < 1.0:
            x, y = (np.where(np.isfinite(rows.floats(n)), rows.floats(n), v) for n, v in (("x", x), ("y", y)))
        else:
            rows = rows.with_columns(x_log=rows.floats("x"), y_log=rows.floats("y"))
    return without(rows, "latitude", "longitude").with_columns(x=x, y=y)


def into_site(rows: Trajectory, frames: Sequence[MapFrame], every: MapFrame | None) -> Trajectory:
    """Rows whose x, y are in a frame of their own, in the site's.

    ``every`` is the frame of all rows; else that of the name that a row gives in ``map_id`` counts, and the
    others stay.  ``level`` is the floor that the frame names.
    """
    if "x" not in rows or "y" not in rows:
        return rows
    if every is not None:
        return _moved(rows, every, np.ones(len(rows), bool))
    maps = rows.labels("map_id")
    for frame in frames:
        if frame.name in maps.names:
            rows = _moved(rows, frame, maps.codes == maps.names.index(frame.name))
    return rows


def _moved(rows: Trajectory, frame: MapFrame, mine: NDArray[np.bool_]) -> Trajectory:
    x, y = frame.to_site(rows.floats("x"), rows.floats("y"))
    turned = np.remainder(rows.floats("heading") + frame.rotation + np.pi, 2.0 * np.pi) - np.pi
    new = {"x": x, "y": y, "heading": turned}
    moved = rows.with_columns(**{n: np.where(mine, v, rows.floats(n)) for n, v in new.items() if n in rows})
    if not frame.level:
        return moved
    levels = [frame.level if m else old for m, old in zip(mine, rows.labels("level").strings(), strict=True)]
    return moved.with_columns(level=Labels.of(levels))


def check_place(x: Floats, y: Floats, site: Site, sample: Trajectory) -> None:
    """:class:`DataError` where the log lies kilometres from the map; ``sample``: the rows as read."""
    good = np.isfinite(x) & np.isfinite(y)
    if site.frame is not None and looks_like_degrees(sample):
        here = [float(np.nanmedian(sample.floats(n))) for n in ("x", "y")]
        about = (site.frame.longitude, site.frame.latitude)
        for names, near in ((("longitude", "latitude"), about), (("latitude", "longitude"), about[::-1])):
            if max(abs(a - b) for a, b in zip(here, near, strict=True)) < 0.5:
                do = f'map them in a profile: [columns] {names[0]} = "x", {names[1]} = "y"'
                raise DataError("the columns x and y hold degrees, not metres", do=do)
    if site.network is None or not good.any():
        return
    away = distance_from_map(float(np.median(x[good])), float(np.median(y[good])), site)
    if away <= FAR:
        return
    what = f"the log is about {away / 1000:,.0f} km from the map of site {site.name!r}"
    do = "check the site's frame and the log's coordinates"
    if "latitude" in sample and site.frame is not None:
        a, b = float(np.nanmedian(sample.floats("latitude"))), float(np.nanmedian(sample.floats("longitude")))
        swapped = site.frame.to_local([b], [a])
        if abs(b) <= 90 and distance_from_map(float(swapped[0][0]), float(swapped[1][0]), site) <= FAR:
            do = "latitude and longitude are exchanged in the log; map them in a profile"
        home = f"{site.frame.latitude:.4f}, {site.frame.longitude:.4f}"
        what += f" (log at {a:.4f}, {b:.4f}; site at {home})"
    raise DataError(what, do=do)


def check_matched(share: float | None, rows: int, site: Site) -> None:
    """:class:`DataError` where next to no row lies on a road: another place, or another frame."""
    if share is not None and rows and share < NO_ROWS:
        what = f"0.0 % of the {rows:,} rows are on a road of site {site.name!r}"
        do = "check the site's frame and the log's coordinates and units, or import without --site"
        raise DataError(what, do=do)


def looks_like_degrees(rows: Trajectory) -> bool:
    """Whether columns called x and y hold degrees: figures that hardly change while the truck moves."""
    good = np.isfinite(rows.floats("x")) & np.isfinite(rows.floats("y"))
    if "latitude" in rows or good.sum() < 10:
        return False
    x, y, speed = (rows.floats(name)[good] for name in ("x", "y", "speed"))
    t = rows.seconds()[good]
    if np.abs(x).max() > 180.0 or np.abs(y).max() > 180.0 or min(np.abs(x).max(), np.abs(y).max()) > 90.0:
        return False
    size = float(max(np.ptp(x), np.ptp(y)))
    driven = float(np.nansum(speed * np.minimum(np.diff(t, prepend=t[:1]), 5.0)))
    if driven > 20.0:
        return size < driven / 1000.0
    fine = bool((np.abs(np.round(x, 4) - x) > 1e-9).mean() > 0.5)
    return fine and 0.0 < size < 0.5 and size < 0.1 * float(np.median(np.hypot(x, y)))


def distance_from_map(x: float, y: float, site: Site) -> float:
    """Distance to the rectangle around the roads [m]."""
    if not (np.isfinite(x) and np.isfinite(y)):
        return float("inf")
    xmin, ymin, xmax, ymax = site.roads().extent
    return float(np.hypot(max(xmin - x, 0.0, x - xmax), max(ymin - y, 0.0, y - ymax)))


def with_frame(site: Site, rows: Trajectory) -> Site:
    """The site, with a frame from the data where it has none, no map, and the log is geographic."""
    if site.frame is not None or "latitude" not in rows:
        return site
    if site.network is not None and "x" in rows:
        return site
    if site.network is not None:
        what = f"the log is geographic and site {site.name!r} does not say where on earth it lies"
        raise DataError(what, do="add [frame] latitude and longitude to the site file")
    return replace(site, frame=frame_from(rows.floats("latitude"), rows.floats("longitude")))
