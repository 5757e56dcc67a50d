"""Where on earth an OpenDRIVE map lies: geoReference with the offset of the header."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.frames import geographic
from fleetlog.roads.formats.base import Floats, Inverse, number

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

NOWHERE = "so the map has no place on earth"


def offset(root: Element) -> tuple[float, float, float]:
    """x, y [m], h [rad] of <offset>: X = x cos h - y sin h + x_off, Y = x sin h + y cos h + y_off."""
    e = root.find("header/offset")
    if e is None:
        return 0.0, 0.0, 0.0
    x, y, h = (number(e.get(k, "0"), f"header offset, {k}") for k in ("x", "y", "hdg"))
    return x, y, h


def moved(x: Floats, y: Floats, by: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """Map coordinates [m] with the header's offset, as the projection takes them."""
    c, s = math.cos(by[2]), math.sin(by[2])
    return x * c - y * s + by[0], x * s + y * c + by[1]


def earth(root: Element, notes: list[str]) -> Inverse | None:
    """Where on earth a map lies; None, and why among the notes, where the file does not say."""
    text = " ".join((root.findtext("header/geoReference") or "").split())
    if "+proj" not in text and "+lat_0" in text and "+lon_0" in text:
        how = "read as transverse Mercator about its lat_0 and lon_0"
        notes.append(f"the geoReference names no projection; it is {how}")
        text = f"+proj=tmerc {text}"
    # Vertical grids are not part of an installation and do not move anything in the plane.
    plain = re.sub(r"\+(geoidgrids|vunits)=\S+", "", text) if text.startswith("+") else text
    if why := _missing(text) or _unknown(plain):
        notes.append(why)
        return None
    by = offset(root)

    def inverse(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return geographic(plain, *moved(x, y, by))

    if not np.isfinite(inverse(np.zeros(1), np.zeros(1))).all():
        notes.append(f"the geoReference does not reach the map's coordinates, {NOWHERE}")
        return None
    return inverse


def _missing(text: str) -> str:
    """Why a geoReference is no place before any projection is asked; empty where it may be one."""
    if not text:
        return f"there is no geoReference, {NOWHERE}; state [frame] in a site.toml to give it one"
    zone, longitude = re.search(r"\+zone=(\d+)", text), re.search(r"\+lon_0=(-?[\d.]+)", text)
    if "+proj=utm" in text and zone and longitude and abs(6 * int(zone[1]) - 183 - float(longitude[1])) > 6.0:
        fault = f"UTM zone {zone[1]} and lon_0 {longitude[1]}"
        return f"the geoReference contradicts itself ({fault}), {NOWHERE}"
    return ""


def _unknown(text: str) -> str:
    """Why PROJ makes no projection to metres of a text; empty where it does."""
    from pyproj import CRS
    from pyproj.exceptions import ProjError

    try:
        crs = CRS.from_user_input(text)
        geographic(text, [], [])
    except ProjError as error:
        return f"the geoReference is not understood ({str(error).splitlines()[0]}), {NOWHERE}"
    return "" if crs.is_projected else f"the geoReference is no projection to metres, {NOWHERE}"
