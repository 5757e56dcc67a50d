"""GPX 1.1: a track per vehicle, a segment per day; other columns as extensions."""

import math
from itertools import groupby
from pathlib import Path
from typing import Any, TextIO
from xml.sax.saxutils import escape, quoteattr

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Exporter, Selection, cells, iso_times
from fleetlog.version import __version__

SPACE = "urn:fleetlog:trajectory:1"
_HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator={creator} '
    'xmlns="http://www.topografix.com/GPX/1/1" '
    'xmlns:fl="{space}">\n'
)
_PLACED = ("x", "y", "z", "heading")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Rows without a position have no place in a track."""
    frame = selection.need_frame("GPX")
    with path.open("w", encoding="utf-8") as out:
        out.write(_HEAD.format(creator=quoteattr(f"fleetlog {__version__}"), space=SPACE))
        for vehicle, days in groupby(selection.days(), lambda t: t.vehicle_id):
            out.write(f"<trk><name>{escape(vehicle)}</name>\n")
            for t in days:
                _segment(out, selection.placed(t), frame)
            out.write("</trk>\n")
        out.write("</gpx>\n")
    return selection.counts


def _segment(out: TextIO, t: Trajectory, frame: Frame) -> None:
    latitude, longitude = frame.to_geographic(t.floats("x"), t.floats("y"))
    extras = [n for n in t.columns if n not in _PLACED and _is_name(n)]
    places = zip(latitude.tolist(), longitude.tolist(), t.floats("z").tolist(), strict=True)
    headings = t.floats("heading").tolist()
    table = list(zip(*cells(t, extras), strict=True)) if extras else [()] * len(t)
    out.write("<trkseg>\n")
    for (lat, lon, z), time, heading, row in zip(places, iso_times(t.time), headings, table, strict=True):
        height = f"<ele>{z:.3f}</ele>" if z == z else ""
        more = "".join(_extension(n, v) for n, v in zip(extras, row, strict=True) if v is not None)
        if heading == heading:
            more += f"<fl:course>{math.degrees(math.pi / 2 - heading) % 360.0:.4f}</fl:course>"
        tail = f"<extensions>{more}</extensions>" if more else ""
        out.write(f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}">{height}<time>{time}</time>{tail}</trkpt>\n')
    out.write("</trkseg>\n")


def _is_name(name: str) -> bool:
    """Whether it can be an element's name as it stands."""
    return name.isascii() and name.replace("_", "").isalnum() and not name[0].isdigit()


def _extension(name: str, value: Any) -> str:
    text = f"{value:.9g}" if isinstance(value, float) else escape(str(value))
    return f"<fl:{name}>{text}</fl:{name}>"


EXPORTER = Exporter("gpx", ".gpx", "GPX 1.1, a track per vehicle", write)
