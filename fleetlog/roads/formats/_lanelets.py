"""Lanelet2 maps (OSM XML whose relations are lanelets), read by that library (the extra ``lanelet2``).

A lanelet that vehicles may use is an edge along its centre line, one that goes both ways two; lanelets follow
one another where they share the end points of both bounds.  Positions are the latitudes and longitudes of the
file.  Limits are those that the map states; changes between lanes are left out.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats._documents import Element
from fleetlog.roads.formats.base import KMH, RoadMap, Tally


def holds_lanelets(root: Element) -> bool:
    """Whether an OSM document is a Lanelet2 map."""
    return root.find("relation/tag[@k='type'][@v='lanelet']") is not None


def read(path: Path) -> RoadMap:
    """Read the lanelets of a map; see the module."""
    try:
        from lanelet2 import io, projection, traffic_rules
    except ImportError:
        do = 'install it with: pip install "fleetlog[lanelet2]"'
        raise SiteError("reading Lanelet2 maps needs lanelet2", do=do) from None
    # Any origin does: what is projected here is taken back to degrees.
    projector = projection.MercatorProjector(io.Origin(0.0, 0.0))
    try:
        found, errors = io.loadRobust(str(path), projector)
    except (RuntimeError, ValueError) as error:
        why = " ".join(str(error).split())[:120]
        raise SiteError(f"cannot be read as a Lanelet2 map ({why})", do="correct the file") from None
    tally = Tally(notes=[" ".join(str(e).split())[:160] for e in list(errors)[:5]])
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    for lanelet in sorted(found.laneletLayer, key=lambda lanelet: lanelet.id):
        if len(lanelet.centerline) < 2 or not rules.canPass(lanelet):
            tally.dropped["not for vehicles" if len(lanelet.centerline) > 1 else "without length"] += 1
            continue
        edge = _edge(lanelet, projector, rules)
        tally.keep(edge, *([] if rules.isOneWay(lanelet) else [reversed_edge(edge)]))
    nothing, do = f"no lanelet that vehicles may use ({tally.read} read)", "tag them for vehicles"
    return tally.road_map("Lanelet2", nothing, do, geographic=True)


def _edge(lanelet: Any, projector: Any, rules: Any) -> Edge:
    """A lanelet along its centre line; its nodes are the points at which both bounds begin and end."""
    from lanelet2.core import BasicPoint3d, SpeedLimit

    back = [projector.reverse(BasicPoint3d(p.x, p.y, p.z)) for p in lanelet.centerline]
    line = np.array([(g.lon, g.lat, g.alt) for g in back]).reshape(-1, 3)
    if not np.isfinite(line).all():
        raise SiteError("a position is not a number", place=f"lanelet {lanelet.id}", do="correct the map")
    # The defaults of a country are not the plant's.
    stated = "speed_limit" in lanelet.attributes
    stated = stated or any(isinstance(r, SpeedLimit) for r in lanelet.regulatoryElements)
    limit = float(rules.speedLimit(lanelet).speedLimit) * KMH if stated else math.nan
    left, right, name = lanelet.leftBound, lanelet.rightBound, str(lanelet.id)
    start, end = (f"{left[k].id}-{right[m].id}" for k, m in ((0, 0), (len(left) - 1, len(right) - 1)))
    return Edge(name, start, end, line, name, limit)
