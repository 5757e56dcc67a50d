"""Frames that files state: a projected system by its EPSG code, and a log's own frame in the site's."""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fleetlog.core.arrays import Floats
from fleetlog.core.schema import Errors, Keys, Wrong, list_of, real, table, text
from fleetlog.core.site import Frame, MapFrame
from fleetlog.errors import InputError

FARTHEST = 1e7  # No point lies farther from an origin [m]


def crs(value: Any) -> str:
    """A reference system that PROJ knows, as ``"EPSG:25832"``."""
    try:
        _to_geographic(text(value))
    except Exception as error:  # pyproj raises several kinds
        raise Wrong("is no reference system that PROJ knows; write it as EPSG:25832") from error
    return str(value)


@lru_cache
def _to_geographic(name: str) -> Any:
    from pyproj import Transformer

    return Transformer.from_crs(name, "EPSG:4326", always_xy=True)


def geographic(name: str, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Latitude, longitude [degrees] of coordinates of a reference system; NaN where it does not reach."""
    longitude, latitude = _to_geographic(name).transform(np.asarray(x, float), np.asarray(y, float))
    known = np.isfinite(longitude) & np.isfinite(latitude)
    return np.where(known, latitude, np.nan), np.where(known, longitude, np.nan)


def frame_of_crs(name: str, easting: float, northing: float, rotation: float | None = None) -> Frame:
    """The site frame whose origin is a point of a projected system.

    Its x axis is that system's unless ``rotation`` says otherwise.  Distances are those on the ground: they
    differ from those of the projection by its scale (0.4 m a kilometre in the middle of a UTM zone).
    """
    latitude, longitude = geographic(name, [easting, easting + 100.0], [northing, northing])
    origin = Frame(float(latitude[0]), float(longitude[0]))
    east, north = origin.to_local(latitude[1], longitude[1])
    turned = math.atan2(float(north), float(east)) if rotation is None else rotation
    return replace(origin, rotation=turned)


MAP_FRAME: Keys = {
    "name": text, "shift": list_of(real(-FARTHEST, FARTHEST), 2, 2), "level": text,
    "rotation": real(-2 * math.pi, 2 * math.pi),
}  # fmt: skip


def map_frames(data: dict[str, Any], where: Path | str, error: Errors = InputError) -> tuple[MapFrame, ...]:
    """All [[map_frame]] tables."""
    raw = data.get("map_frame", [])
    if not isinstance(raw, list):
        raise error("is not a list of tables", where=where, place="map_frame", do="write [[map_frame]]")
    checked = (table(row, MAP_FRAME, where, f"map_frame[{n}]", ("name",), error) for n, row in enumerate(raw))
    return tuple(MapFrame(**row) for row in checked)
