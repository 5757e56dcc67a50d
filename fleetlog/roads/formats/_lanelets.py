"""Lanelet2 maps (OSM XML whose relations are lanelets), read by that library (the extra ``lanelet2``).

A lanelet that vehicles may use is an edge along its centre line, one that goes both ways two; lanelets follow
one another where they share the end points of both bounds.  Positions are the latitudes and longitudes of the
file.  Limits are those that the map states; changes between lanes are left out.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fleetlog.core.network import Edge, reversed_edge
from fleetlog.errors import SiteError
from fleetlog.roads.formats.base import KMH, Floats, RoadMap, Tally

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def holds_lanelets(root: Element) -> bool:
    """Whether an OSM document is a Lanelet2 map."""
    return root.find("relation/tag[@k='type'][@v='lanelet']") is not None


def read(path: Path) -> RoadMap:
    """Read the lanelets of a map; see the module."""
    tally = Tally()
    lanelets, projector, rules = _loaded(path, tally)
    edges = [edge for lanelet in lanelets for edge in _edges(lanelet, projector, rules, tally)]
    if not edges:
        raise SiteError(f"no lanelet that vehicles may use ({tally.read} read)", do="tag them for vehicles")
    return RoadMap(edges, tally.report("Lanelet2"), geographic=True)


def _loaded(path: Path, tally: Tally) -> tuple[list[Any], Any, Any]:
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
    tally.notes += [" ".join(str(e).split())[:160] for e in list(errors)[:5]]
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    return sorted(found.laneletLayer, key=lambda lanelet: lanelet.id), projector, rules


def _edges(lanelet: Any, projector: Any, rules: Any, tally: Tally) -> list[Edge]:
    tally.read += 1
    line = _line(lanelet, projector)
    if not rules.canPass(lanelet) or len(line) < 2:
        tally.drop("not for vehicles" if len(line) > 1 else "without length")
        return []
    tally.kept += 1
    start, end = _nodes(lanelet.leftBound, lanelet.rightBound)
    name = str(lanelet.id)
    edge = Edge(name, start, end, line, name, _limit(lanelet, rules))
    return [edge] if rules.isOneWay(lanelet) else [edge, reversed_edge(edge)]


def _nodes(left: Any, right: Any) -> tuple[str, str]:
    """The nodes between lanelets: the points at which both bounds begin and end."""
    return f"{left[0].id}-{right[0].id}", f"{left[len(left) - 1].id}-{right[len(right) - 1].id}"


def _line(lanelet: Any, projector: Any) -> Floats:
    """(n, 3) longitude, latitude [degrees], height [m] of the centre line."""
    from lanelet2.core import BasicPoint3d

    back = [projector.reverse(BasicPoint3d(p.x, p.y, p.z)) for p in lanelet.centerline]
    line = np.array([(g.lon, g.lat, g.alt) for g in back]).reshape(-1, 3)
    if not np.isfinite(line).all():
        raise SiteError("a position is not a number", place=f"lanelet {lanelet.id}", do="correct the map")
    return (
        line[np.append(True, np.abs(np.diff(line[:, :2], axis=0)).max(axis=1) > 0.0)] if len(line) else line
    )


def _limit(lanelet: Any, rules: Any) -> float:
    """The limit that the map states [m/s]; the defaults of a country are not the plant's."""
    from lanelet2.core import SpeedLimit

    stated = "speed_limit" in lanelet.attributes
    stated = stated or any(isinstance(r, SpeedLimit) for r in lanelet.regulatoryElements)
    return float(rules.speedLimit(lanelet).speedLimit) * KMH if stated else math.nan
