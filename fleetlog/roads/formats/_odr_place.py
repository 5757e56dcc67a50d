"""Where on earth an OpenDRIVE map lies: geoReference with the offset of the header."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.roads.formats.base import Floats, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

Inverse = Callable[[Floats, Floats], tuple[Floats, Floats]]


def offset(root: Element, path: Path) -> tuple[float, float, float]:
    """x, y [m] and heading [rad] of <offset>:
    X = x cos h - y sin h + x_off, Y = x sin h + y cos h + y_off.
    """
    e = root.find("header/offset")
    if e is None:
        return 0.0, 0.0, 0.0
    x, y, h = (number(e.get(k, "0"), path, f"header offset, {k}") for k in ("x", "y", "hdg"))
    return x, y, h


def moved(x: Floats, y: Floats, by: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """Map coordinates [m] with the header's offset, as the projection takes them."""
    c, s = math.cos(by[2]), math.sin(by[2])
    return x * c - y * s + by[0], x * s + y * c + by[1]


def geographic(root: Element, path: Path, notes: list[str]) -> Inverse | None:
    """(x, y) of the map to (latitude, longitude) [degrees]; None, and why, where the file does not say."""
    text = " ".join((root.findtext("header/geoReference") or "").split())
    if not text:
        notes.append(
            "there is no geoReference, so the map has no place on earth; "
            "state [frame] in a site.toml to give it one"
        )
        return None
    if "+proj" not in text and "+lat_0" in text and "+lon_0" in text:
        notes.append(
            "the geoReference names no projection; it is read as transverse Mercator about its lat_0 and "
            "lon_0"
        )
        text = f"+proj=tmerc {text}"
    if fault := _contradiction(text):
        notes.append(f"the geoReference contradicts itself ({fault}), so the map has no place on earth")
        return None
    by = offset(root, path)
    inverse = _inverse(text, by, notes)
    if inverse is not None and not np.isfinite(np.array(inverse(np.zeros(1), np.zeros(1)))).all():
        notes.append(
            "the geoReference does not reach the map's coordinates, so the map has no place on earth"
        )
        return None
    return inverse


def _contradiction(text: str) -> str:
    zone, longitude = re.search(r"\+zone=(\d+)", text), re.search(r"\+lon_0=(-?[\d.]+)", text)
    if "+proj=utm" in text and zone and longitude and abs(6 * int(zone[1]) - 183 - float(longitude[1])) > 6.0:
        return f"UTM zone {zone[1]} and lon_0 {longitude[1]}"
    return ""


def _inverse(text: str, by: tuple[float, float, float], notes: list[str]) -> Inverse | None:
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    # Vertical grids are not part of an installation and do not move anything in the plane.
    plain = re.sub(r"\+(geoidgrids|vunits)=\S+", "", text) if text.startswith("+") else text
    try:
        crs = CRS.from_user_input(plain)
        transformer = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    except ProjError as error:
        notes.append(
            f"the geoReference is not understood ({str(error).splitlines()[0]}), "
            "so the map has no place on earth"
        )
        return None
    if not crs.is_projected:
        notes.append("the geoReference is no projection to metres, so the map has no place on earth")
        return None

    def inverse(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        longitude, latitude = transformer.transform(*moved(x, y, by))
        return np.asarray(latitude, dtype=np.float64), np.asarray(longitude, dtype=np.float64)

    return inverse
