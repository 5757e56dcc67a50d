"""The site as an openTCS plant model (XML, version 6.0.0): points, paths, and locations for the places.

Lengths are millimetres.  A path goes one way; a road of both directions is two paths.  A road with bends is a
chain of straight paths.  Every place is a location with the operation of its kind, linked to the point on the
road from which it is reached.  Source: the schema of the openTCS project.
"""

import math
from pathlib import Path
from typing import Any

from lxml import etree

from fleetlog.core.site import Place
from fleetlog.exporters._lanes import Lane, Lanes, lanes_of
from fleetlog.exporters.base import Exporter, Selection

MILLI = 1000.0
DEFAULT_SPEED = 1.0
"""Speed of a path whose limit the map does not give [m/s]: that of the model editor."""
OPERATIONS = {"pick": "Load", "drop": "Unload", "park": "Park", "charge": "Charge"}
BOX = {
    "length": "1000",
    "width": "1000",
    "height": "1000",
    "referenceOffsetX": "500",
    "referenceOffsetY": "500",
}
"""Of a vehicle that may stand at a point [mm]: the model editor's."""


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The model of the dataset's site."""
    site = selection.dataset.site
    lanes = lanes_of(site)
    model = etree.Element("model", version="6.0.0", name=site.name)
    _points(model, lanes)
    for lane in lanes.lanes:
        _path(model, lane)
    for kind, operation in OPERATIONS.items():
        if any(p.kind == kind for p in lanes.stops.values()):
            allowed = etree.SubElement(model, "locationType", name=kind)
            etree.SubElement(allowed, "allowedOperation", name=operation)
    for point, place in lanes.stops.items():
        _location(model, place, point)
    etree.ElementTree(model).write(str(path), xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return {"rows": len(lanes.lanes), "edges": len(lanes.lanes), "points": len(lanes.points)}


def _place(x: float, y: float, z: float = 0.0) -> dict[str, str]:
    return {f"position{axis}": str(round(v * MILLI)) for axis, v in zip("XYZ", (x, y, z), strict=True)}


def _points(model: Any, lanes: Lanes) -> None:
    leaving: dict[str, list[str]] = {}
    for lane in lanes.lanes:
        leaving.setdefault(lane.start, []).append(lane.name)
    for name, xyz in lanes.points.items():
        point = etree.SubElement(model, "point", name=name, type="HALT_POSITION", **_place(*xyz.tolist()))
        etree.SubElement(point, "maxVehicleBoundingBox", **BOX)
        for path in leaving.get(name, ()):
            etree.SubElement(point, "outgoingPath", name=path)


def _path(model: Any, lane: Lane) -> None:
    speed = DEFAULT_SPEED if math.isnan(lane.limit) else lane.limit
    etree.SubElement(
        model, "path", name=lane.name, sourcePoint=lane.start, destinationPoint=lane.end,
        length=str(max(round(lane.length * MILLI), 1)), maxVelocity=str(max(round(speed * MILLI), 1)),
        maxReverseVelocity="0", locked="false",
    )  # fmt: skip


def _location(model: Any, place: Place, point: str) -> None:
    location = etree.SubElement(
        model, "location", name=place.id, type=place.kind, locked="false", **_place(place.x, place.y)
    )
    etree.SubElement(location, "link", point=point)


EXPORTER = Exporter("opentcs", ".xml", "the site as an openTCS plant model", write, network=True)
