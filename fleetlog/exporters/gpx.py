"""GPX 1.1: a track per vehicle, a segment per day; other columns as extensions."""

import math
import re
from itertools import groupby
from pathlib import Path
from typing import TextIO
from xml.sax.saxutils import escape, quoteattr

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import DataError
from fleetlog.exporters.base import Selection, cells, iso_times
from fleetlog.version import __version__

SPACE = "urn:fleetlog:trajectory:1"
_HEAD = f"""<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator={quoteattr(f"fleetlog {__version__}")} xmlns="http://www.topografix.com/GPX/1/1" \
xmlns:fl="{SPACE}">
"""
_PLACED = ("x", "y", "z", "heading")
_NAME = re.compile(r"(?!\d)\w+", re.ASCII)  # What can be an element's name as it stands


def write(selection: Selection, path: Path) -> None:
    """Rows without a position have no place in a track."""
    if (frame := selection.dataset.site.frame) is None:
        what = "GPX holds latitudes and longitudes, and this dataset's site has no [frame]"
        do = "import it again with a site that has one, or export to csv, parquet, tum or sumo-fcd"
        raise DataError(what, where=selection.dataset.path, do=do)
    with path.open("w", encoding="utf-8") as out:
        out.write(_HEAD)
        for vehicle, days in groupby(selection.days(), lambda t: t.vehicle_id):
            out.write(f"<trk><name>{escape(vehicle)}</name>\n")
            for t in days:
                _segment(out, selection.placed(t), frame)
            out.write("</trk>\n")
        out.write("</gpx>\n")


def _segment(out: TextIO, t: Trajectory, frame: Frame) -> None:
    latitude, longitude = frame.to_geographic(t.floats("x"), t.floats("y"))
    extras = [n for n in t.columns if n not in _PLACED and _NAME.fullmatch(n)]
    columns = (c.tolist() for c in (latitude, longitude, t.floats("z"), t.floats("heading")))
    out.write("<trkseg>\n")
    for lat, lon, z, heading, time, *row in zip(*columns, iso_times(t.time), *cells(t, extras), strict=True):
        height = f"<ele>{z:.3f}</ele>" if z == z else ""
        known = ((n, v) for n, v in zip(extras, row, strict=True) if v is not None)
        texts = ((n, f"{v:.9g}" if isinstance(v, float) else escape(str(v))) for n, v in known)
        more = "".join(f"<fl:{n}>{text}</fl:{n}>" for n, text in texts)
        if heading == heading:
            more += f"<fl:course>{math.degrees(math.pi / 2 - heading) % 360.0:.4f}</fl:course>"
        tail = f"<extensions>{more}</extensions>" if more else ""
        out.write(f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}">{height}<time>{time}</time>{tail}</trkpt>\n')
    out.write("</trkseg>\n")
