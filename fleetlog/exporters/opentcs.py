"""The site as an openTCS plant model (XML, version 6.0.0): points, paths, and locations for the places.

Lengths are millimetres.  A path goes one way; a road of both directions is two paths.  A road with bends is a
chain of straight paths.  Every place is a location with the operation of its kind, linked to the point on the
road from which it is reached.  Source: the schema of the openTCS project."""

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

from lxml import etree

from fleetlog.exporters._lanes import Lane, lanes_of
from fleetlog.exporters.base import Selection

MILLI = 1000.0
DEFAULT_SPEED = 1.0  # Speed of a path whose limit the map does not give [m/s]: that of the model editor
OPERATIONS = {"pick": "Load", "drop": "Unload", "park": "Park", "charge": "Charge"}
BOX = dict.fromkeys(("length", "width", "height"), "1000")
BOX |= {"referenceOffsetX": "500", "referenceOffsetY": "500"}
"""Of a vehicle that may stand at a point [mm]: the model editor's."""


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The model of the dataset's site."""
    site = selection.dataset.site
    lanes = lanes_of(site)
    leaving: dict[str, list[Lane]] = defaultdict(list)
    for lane in lanes.lanes:
        leaving[lane.start].append(lane)
    model = etree.Element("model", version="6.0.0", name=site.name)
    for name, xyz in lanes.points.items():
        point = etree.SubElement(model, "point", name=name, type="HALT_POSITION", **_place(*xyz.tolist()))
        etree.SubElement(point, "maxVehicleBoundingBox", BOX)
        for lane in leaving[name]:
            etree.SubElement(point, "outgoingPath", name=lane.name)
    for lane in lanes.lanes:
        speed = DEFAULT_SPEED if math.isnan(lane.limit) else lane.limit
        etree.SubElement(
            model, "path", name=lane.name, sourcePoint=lane.start, destinationPoint=lane.end,
            length=str(max(round(lane.length * MILLI), 1)), maxVelocity=str(max(round(speed * MILLI), 1)),
            maxReverseVelocity="0", locked="false",
        )  # fmt: skip
    for kind, operation in OPERATIONS.items():
        if any(p.kind == kind for p in lanes.stops.values()):
            allowed = etree.SubElement(model, "locationType", name=kind)
            etree.SubElement(allowed, "allowedOperation", name=operation)
    for point, p in lanes.stops.items():
        where = _place(p.x, p.y)
        location = etree.SubElement(model, "location", name=p.id, type=p.kind, locked="false", **where)
        etree.SubElement(location, "link", point=point)
    etree.ElementTree(model).write(str(path), xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return {"rows": len(lanes.lanes), "edges": len(lanes.lanes), "points": len(lanes.points)}


def _place(x: float, y: float, z: float = 0.0) -> dict[str, str]:
    return {f"position{axis}": str(round(v * MILLI)) for axis, v in zip("XYZ", (x, y, z), strict=True)}
