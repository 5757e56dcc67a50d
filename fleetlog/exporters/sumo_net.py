"""The site's road network as a SUMO ``.net.xml``, for sumo, netconvert, duarouter and sumolib.

A directed edge is an edge of one lane on the same line; what may follow it is a connection.  There are no
lanes inside junctions: a vehicle passes from edge to edge at once.  Where two connections cross or merge the
earlier one in the file has the right of way.  An edge without a speed limit gets ``DEFAULT_SPEED``.
https://sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html
"""

import re
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, TextIO
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.site import Frame
from fleetlog.exporters.base import Exporter, Selection

DEFAULT_SPEED = 5.0
"""Speed of a lane whose limit the map does not give [m/s]: the default top speed of a truck."""
DEFAULT_WIDTH = 3.2
"""Width of a lane whose width the map does not give [m]: SUMO's own default."""
Connection = tuple[int, int]
_FORBIDDEN = re.compile(r"[\s|\\'\";,<>&!#%]")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The network of the dataset's site."""
    n = selection.dataset.site.roads()
    names = _unique([sumo_name(e) for e in n.edge_ids])
    nodes = _unique([sumo_name(v) for v in n.node_ids])
    with path.open("w", encoding="utf-8") as out:
        out.write('<?xml version="1.0" encoding="UTF-8"?>\n<net version="1.20" limitTurnSpeed="5.50">\n')
        out.write(_location(n, selection.frame))
        for i in range(len(n)):
            _edge(out, n, i, names[i], nodes)
        connections = _by_node(n)
        for v in range(len(nodes)):
            _junction(out, n, v, nodes[v], names, connections[v])
        for v in range(len(nodes)):
            for a, b in connections[v]:
                _connection(out, n, a, b, names)
        out.write("</net>\n")
    return {"rows": len(n), "edges": len(n), "junctions": len(nodes)}


def sumo_name(name: str) -> str:
    """``name`` without the characters that SUMO's ids must not have."""
    clean = _FORBIDDEN.sub("_", name)
    return "_" + clean if clean.startswith(":") or not clean else clean


def _unique(names: list[str]) -> list[str]:
    """Names that cleaning made equal, told apart again."""
    seen: Counter[str] = Counter()
    out = []
    for name in names:
        seen[name] += 1
        out.append(name if seen[name] == 1 else f"{name}__{seen[name]}")
    return out


def _location(n: Network, frame: Frame | None) -> str:
    x0, y0, x1, y1 = n.extent
    geographic, projection = "-10000000000.00,-10000000000.00,10000000000.00,10000000000.00", "!"
    if frame is not None and frame.rotation == 0.0:
        latitude, longitude = frame.to_geographic([x0, x1], [y0, y1])
        geographic = f"{longitude[0]:.6f},{latitude[0]:.6f},{longitude[1]:.6f},{latitude[1]:.6f}"
        projection = (
            f"+proj=aeqd +lat_0={frame.latitude!r} +lon_0={frame.longitude!r} +ellps=WGS84 +units=m +no_defs"
        )
    return (
        f'  <location netOffset="0.00,0.00" convBoundary="{x0:.2f},{y0:.2f},{x1:.2f},{y1:.2f}" '
        f"origBoundary={quoteattr(geographic)} projParameter={quoteattr(projection)}/>\n"
    )


def _shape(points: NDArray[np.float64], heights: bool) -> str:
    width = 3 if heights else 2
    return " ".join(",".join(f"{c:.3f}" for c in p[:width]) for p in points.tolist())


def _edge(out: TextIO, n: Network, i: int, name: str, nodes: list[str]) -> None:
    limit, width = float(n.speed_limit[i]), float(n.width[i])
    speed = limit if np.isfinite(limit) and limit > 0 else DEFAULT_SPEED
    wide = f' width="{width:.2f}"' if np.isfinite(width) and width > 0 else ""
    out.write(
        f"  <edge id={quoteattr(name)} from={quoteattr(nodes[n.start[i]])} to={quoteattr(nodes[n.end[i]])} "
        f'priority="-1" spreadType="center">\n'
        f'    <lane id={quoteattr(name + "_0")} index="0" speed="{speed:.2f}" '
        f'length="{max(float(n.length[i]), 0.1):.3f}"{wide} '
        f'shape="{_shape(n.polyline(i), n.has_elevation)}"/>\n  </edge>\n'
    )


def _by_node(n: Network) -> dict[int, list[Connection]]:
    """The connections at every node, in the order of the incoming edges."""
    out: dict[int, list[Connection]] = defaultdict(list)
    for a in range(len(n)):
        out[int(n.end[a])] += [(a, int(b)) for b in n.successors(a) if int(n.start[b]) == int(n.end[a])]
    return out


def _junction(out: TextIO, n: Network, v: int, name: str, names: list[str], links: list[Connection]) -> None:
    x, y, z = n.node_points[v].tolist()
    incoming = [names[i] + "_0" for i in np.flatnonzero(n.end == v)]
    height = f' z="{z:.3f}"' if n.has_elevation else ""
    kind = "priority" if links else "dead_end"
    out.write(
        f'  <junction id={quoteattr(name)} type="{kind}" x="{x:.3f}" y="{y:.3f}"{height} '
        f'incLanes={quoteattr(" ".join(incoming))} intLanes="" '
        f'shape="{_shape(_square(x, y, z), n.has_elevation)}"'
    )
    if not links:
        out.write("/>\n")
        return
    out.write(">\n")
    foes = np.array([[_conflict(n, a, b) for b in links] for a in links], dtype=bool)
    yields = np.tril(foes, -1)
    for i in range(len(links)):
        # SUMO writes these bits from the last link to the first
        response, foe = ("".join("1" if bit else "0" for bit in row[i][::-1]) for row in (yields, foes))
        out.write(f'    <request index="{i}" response="{response}" foes="{foe}" cont="0"/>\n')
    out.write("  </junction>\n")


def _square(x: float, y: float, z: float) -> NDArray[np.float64]:
    r = DEFAULT_WIDTH / 2
    return np.array([[x - r, y - r, z], [x - r, y + r, z], [x + r, y + r, z], [x + r, y - r, z]])


def _conflict(n: Network, a: Connection, b: Connection) -> bool:
    """Whether two connections from different edges of a junction merge, or cross."""
    if a[0] == b[0]:
        return False
    if a[1] == b[1]:
        return True
    p, q = _way(n, a), _way(n, b)
    return _turns(p, q[0]) * _turns(p, q[1]) < 0 and _turns(q, p[0]) * _turns(q, p[1]) < 0


def _way(n: Network, link: Connection) -> NDArray[np.float64]:
    """From a metre before the end of the first edge to a metre after the start of the second, (2, 2) m."""
    edges = np.array(link, dtype=np.int32)
    offsets = np.array([max(float(n.length[link[0]]) - 1.0, 0.0), min(1.0, float(n.length[link[1]]))])
    return np.asarray(n.position(edges, offsets)[:, :2], dtype=np.float64)


def _turns(line: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    (ax, ay), (bx, by) = line.tolist()
    return float((bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax))


def _connection(out: TextIO, n: Network, a: int, b: int, names: list[str]) -> None:
    before = float(n.heading(np.array([a]), np.array([n.length[a]]))[0])
    after = float(n.heading(np.array([b]), np.array([0.0]))[0])
    turn = float(np.degrees(np.remainder(after - before + np.pi, 2 * np.pi) - np.pi))
    way = "s" if abs(turn) < 45 else "t" if abs(turn) > 135 else "l" if turn > 0 else "r"
    out.write(
        f'  <connection from={quoteattr(names[a])} to={quoteattr(names[b])} fromLane="0" toLane="0" '
        f'dir="{way}" state="M"/>\n'
    )


EXPORTER = Exporter("sumo-net", ".net.xml", "the road network for SUMO", write, network=True)
