"""The site's road network as a SUMO ``.net.xml``, for sumo, netconvert, duarouter and sumolib.

A directed edge is an edge of one lane on the same line; what may follow it is a connection.  There are no
lanes inside junctions: a vehicle passes from edge to edge at once.  Where two connections cross or merge the
earlier one in the file has the right of way.  An edge without a speed limit gets ``DEFAULT_SPEED``.
https://sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.network import Network
from fleetlog.exporters.base import Selection

DEFAULT_SPEED = 5.0  # Of a lane whose limit the map does not give [m/s]: the default top speed of a truck
HALF_WIDTH = 1.6  # Of a junction [m]: that of SUMO's own lanes
ANYWHERE = "-10000000000.00,-10000000000.00,10000000000.00,10000000000.00"
Connection = tuple[int, int]
_FORBIDDEN = re.compile(r"[\s|\\'\";,<>&!#%]")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The network of the dataset's site."""
    n = selection.dataset.site.roads()
    edges, nodes = ([*_told_apart(map(sumo_name, names))] for names in (n.edge_ids, n.node_ids))
    net = etree.Element("net", version="1.20", limitTurnSpeed="5.50")
    frame, (x0, y0, x1, y1) = selection.dataset.site.frame, n.extent
    geographic, projection = ANYWHERE, "!"
    if frame is not None and frame.rotation == 0.0:
        latitude, longitude = frame.to_geographic([x0, x1], [y0, y1])
        geographic = f"{longitude[0]:.6f},{latitude[0]:.6f},{longitude[1]:.6f},{latitude[1]:.6f}"
        origin = f"+lat_0={frame.latitude!r} +lon_0={frame.longitude!r}"
        projection = f"+proj=aeqd {origin} +ellps=WGS84 +units=m +no_defs"
    local = {"netOffset": "0.00,0.00", "convBoundary": f"{x0:.2f},{y0:.2f},{x1:.2f},{y1:.2f}"}
    etree.SubElement(net, "location", {**local, "origBoundary": geographic, "projParameter": projection})
    links: dict[int, list[Connection]] = defaultdict(list)
    for i, name in enumerate(edges):
        ends = {"id": name, "from": nodes[n.start[i]], "to": nodes[n.end[i]]}
        edge = etree.SubElement(net, "edge", {**ends, "priority": "-1", "spreadType": "center"})
        limit, width = float(n.speed_limit[i]), float(n.width[i])
        speed = limit if np.isfinite(limit) and limit > 0 else DEFAULT_SPEED
        wide = {"width": f"{width:.2f}"} if np.isfinite(width) and width > 0 else {}
        length = f"{max(float(n.length[i]), 0.1):.3f}"
        lane = {"id": f"{name}_0", "index": "0", "speed": f"{speed:.2f}", "length": length, **wide}
        etree.SubElement(edge, "lane", {**lane, "shape": _shape(n, n.polyline(i))})
        links[int(n.end[i])] += [(i, int(b)) for b in n.successors(i) if n.start[b] == n.end[i]]
    for v, name in enumerate(nodes):
        incoming = " ".join(f"{edges[i]}_0" for i in np.flatnonzero(n.end == v))
        _junction(net, n, v, {"id": name, "incLanes": incoming}, links[v])
    for a, b in (link for v in range(len(nodes)) for link in links[v]):
        lanes = {"from": edges[a], "to": edges[b], "fromLane": "0", "toLane": "0"}
        etree.SubElement(net, "connection", {**lanes, "dir": _direction(n, a, b), "state": "M"})
    etree.ElementTree(net).write(str(path), xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return {"rows": len(n), "edges": len(n), "junctions": len(nodes)}


def sumo_name(name: str) -> str:
    """``name`` without the characters that SUMO's ids must not have."""
    clean = _FORBIDDEN.sub("_", name)
    return "_" + clean if clean.startswith(":") or not clean else clean


def _told_apart(names: Iterable[str]) -> Iterator[str]:
    """Those that cleaning made equal are numbered."""
    seen: Counter[str] = Counter()
    for name in names:
        seen[name] += 1
        yield name if seen[name] == 1 else f"{name}__{seen[name]}"


def _shape(n: Network, points: Floats) -> str:
    width = 3 if n.has_elevation else 2
    return " ".join(",".join(f"{c:.3f}" for c in p[:width]) for p in points.tolist())


def _junction(net: Any, n: Network, v: int, names: dict[str, str], links: list[Connection]) -> None:
    middle, r = n.node_points[v], HALF_WIDTH
    corners = middle + np.array([[-r, -r, 0.0], [-r, r, 0.0], [r, r, 0.0], [r, -r, 0.0]])
    place = {axis: f"{c:.3f}" for axis, c in zip("xyz" if n.has_elevation else "xy", middle, strict=False)}
    how = {"type": "priority" if links else "dead_end", **place, "intLanes": "", "shape": _shape(n, corners)}
    junction = etree.SubElement(net, "junction", {**names, **how})
    foes = _foes(n, links)
    for i, both in enumerate(zip(np.tril(foes, -1), foes, strict=True)):
        # SUMO writes these bits from the last link to the first
        response, foe = ("".join("01"[bit] for bit in row[::-1].astype(int)) for row in both)
        etree.SubElement(junction, "request", index=str(i), response=response, foes=foe, cont="0")


def _foes(n: Network, links: list[Connection]) -> Mask:
    """Which of the connections of a junction merge or cross, from different edges: (L, L). A connection is
    seen as the line from a metre before the end of its first edge to a metre after the start of its second;
    two cross where each has the ends of the other on both its sides."""
    a, b = np.array(links, np.int32).reshape(-1, 2).T
    first = n.position(a, np.maximum(n.length[a] - 1.0, 0.0))[:, :2]
    last = n.position(b, np.minimum(n.length[b], 1.0))[:, :2]
    way = (last - first)[:, None]

    def side(points: Floats) -> Floats:
        to = points - first[:, None]
        return np.asarray(way[..., 0] * to[..., 1] - way[..., 1] * to[..., 0])

    parted = side(first) * side(last) < 0.0
    return np.asarray((a[:, None] != a) & ((b[:, None] == b) | (parted & parted.T)))


def _direction(n: Network, a: int, b: int) -> str:
    """Straight on, left, right or a turn round."""
    before, after = n.heading(np.array([a, b]), np.array([n.length[a], 0.0])).tolist()
    turn = float(np.degrees(np.remainder(after - before + np.pi, 2 * np.pi) - np.pi))
    return "s" if abs(turn) < 45 else "t" if abs(turn) > 135 else "l" if turn > 0 else "r"
