"""The site as an Open-RMF navigation graph (``nav_graphs/0.yaml``): vertices in metres, directed lanes.

A road with bends is a chain of straight lanes.  Every place is a vertex on the road from which it is reached,
marked by its kind: charger, parking spot, dispenser (pick) or ingestor (drop)."""

import math
from pathlib import Path
from typing import Any

from fleetlog.core.site import Place
from fleetlog.exporters._lanes import lanes_of
from fleetlog.exporters.base import Selection
from fleetlog.roads.formats.open_rmf import MARKS

LEVEL = "L1"


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The graph of the dataset's site, on one level."""
    from ruamel.yaml import YAML

    site = selection.dataset.site
    lanes = lanes_of(site)
    number = {name: k for k, name in enumerate(lanes.points)}
    places = ((lanes.stops.get(name), xyz[:2].round(4)) for name, xyz in lanes.points.items())
    vertices = [[*xy.tolist(), _said(place)] for place, xy in places]
    limits = ({} if math.isnan(a.limit) else {"speed_limit": a.limit} for a in lanes.lanes)
    rows = [[number[a.start], number[a.end], said] for a, said in zip(lanes.lanes, limits, strict=True)]
    graph = {"building_name": site.name, "levels": {LEVEL: {"lanes": rows, "vertices": vertices}}}
    with path.open("w", encoding="utf-8") as out:
        YAML(typ="safe", pure=True).dump(graph, out)
    return {"rows": len(rows), "edges": len(rows), "vertices": len(vertices)}


def _said(place: Place | None) -> dict[str, Any]:
    """What is said of a vertex; names are those of places, for robots are sent there by name."""
    if place is None:
        return {"name": ""}
    mark = next(mark for mark, kind in MARKS.items() if kind == place.kind)
    return {"name": place.id, mark: True if mark.startswith("is_") else place.id}
