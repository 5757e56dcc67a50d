"""Draw the sample plant: two halls, a yard between them, and a ramp up to the eastern hall.

    python make_plant.py

writes ``plant.xodr`` (OpenDRIVE, with the ramp), ``roads.geojson`` (the same roads as a plant's floor plan has
them: without heights), ``site.toml`` (places, zones, buildings) and ``site_3d.toml`` (the same site on the OpenDRIVE map).
Nothing of fleetlog is used: the map is an input, not a result.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import quoteattr

HERE = Path(__file__).parent
LATITUDE, LONGITUDE = 49.9769, 9.1513
LANE = 2.0  # lane width [m]
ONE_WAY_WIDTH = 3.0
CUT = 3.0  # a junction takes this much of every road that meets there [m]
RAMP_HEIGHT = 1.0

NODES: dict[str, tuple[float, float]] = {}
for i, x in enumerate((8.0, 18.0, 28.0, 38.0)):
    for j, y in enumerate((6.0, 30.0, 54.0)):
        NODES[f"a{i}{j}"] = (x, y)
for j, y in enumerate((6.0, 30.0, 54.0)):
    NODES[f"y{j}"] = (54.0, y)
    NODES[f"z{j}"] = (84.0, y)
for i, x in enumerate((110.0, 122.0, 134.0)):
    for j, y in enumerate((12.0, 30.0, 48.0)):
        NODES[f"b{i}{j}"] = (x, y)


@dataclass(eq=False)
class Road:
    """A road between two nodes: straight, or one arc that bulges to the left by ``bulge`` metres."""

    id: str
    start: str
    end: str
    oneway: bool = False
    speed: float = 3.0
    bulge: float = 0.0
    ramp: bool = False
    number: int = field(default=0)

    @property
    def chord(self) -> float:
        (x0, y0), (x1, y1) = NODES[self.start], NODES[self.end]
        return math.hypot(x1 - x0, y1 - y0)

    @property
    def curvature(self) -> float:
        """Of the centre line; a bulge to the left needs a right-hand arc."""
        if not self.bulge:
            return 0.0
        h = self.bulge
        return -math.copysign(8 * abs(h) / (self.chord**2 + 4 * h * h), h)

    @property
    def length(self) -> float:
        k = abs(self.curvature)
        return self.chord if k == 0 else 2 / k * math.asin(min(1.0, self.chord * k / 2))

    def at(self, s: float) -> tuple[float, float, float]:
        """x, y, heading at ``s`` from the start node."""
        (x0, y0), (x1, y1) = NODES[self.start], NODES[self.end]
        h, k = math.atan2(y1 - y0, x1 - x0), self.curvature
        if k == 0.0:
            return x0 + s * math.cos(h), y0 + s * math.sin(h), h
        h0 = h - k * self.length / 2
        return (
            x0 + (math.sin(h0 + k * s) - math.sin(h0)) / k,
            y0 - (math.cos(h0 + k * s) - math.cos(h0)) / k,
            h0 + k * s,
        )

    def height(self, s: float) -> float:
        """z [m]; the ramp is a smooth step between the junctions at its ends."""
        if not self.ramp:
            return RAMP_HEIGHT if self.start.startswith("b") else 0.0
        u = min(max((s - CUT) / (self.length - 2 * CUT), 0.0), 1.0)
        return RAMP_HEIGHT * u * u * (3 - 2 * u)


def roads() -> list[Road]:
    """The forty roads, numbered."""
    out = []
    for j in range(3):
        out += [Road(f"a-cross-{j}{i}", f"a{i}{j}", f"a{i + 1}{j}", speed=2.5) for i in range(3)]
    for i in range(4):
        one_way = i in (1, 2)
        for j in range(2):
            ends = (f"a{i}{j}", f"a{i}{j + 1}")
            ends = ends[::-1] if i == 2 else ends
            out.append(Road(f"a-aisle-{i}{j}", *ends, oneway=one_way, speed=2.5))
    out += [Road(f"gate-{j}", f"a3{j}", f"y{j}", speed=2.0) for j in range(3)]
    out += [Road(f"yard-west-{j}", f"y{j}", f"y{j + 1}", speed=4.0) for j in range(2)]
    out += [Road(f"yard-{j}", f"y{j}", f"z{j}", speed=4.0, bulge=b) for j, b in enumerate((-4.0, 0.0, 4.0))]
    out += [Road(f"yard-east-{j}", f"z{j}", f"z{j + 1}", speed=4.0) for j in range(2)]
    out.append(Road("ramp", "z1", "b01", speed=3.0, ramp=True))
    for j in range(3):
        out += [Road(f"b-cross-{j}{i}", f"b{i}{j}", f"b{i + 1}{j}", speed=2.5) for i in range(2)]
    for i in range(3):
        out += [Road(f"b-aisle-{i}{j}", f"b{i}{j}", f"b{i}{j + 1}", speed=2.5) for j in range(2)]
    for number, road in enumerate(out, start=1):
        road.number = number
    return out


ROADS = roads()

PLACES = [
    ("dock-1", "pick", 13.0, 6.0), ("dock-2", "pick", 23.0, 6.0), ("dock-3", "pick", 33.0, 6.0),
    ("rack-1", "drop", 8.0, 18.0), ("rack-2", "drop", 38.0, 42.0), ("rack-3", "drop", 23.0, 54.0),
    ("line-1", "drop", 110.0, 39.0), ("line-2", "drop", 122.0, 39.0), ("line-3", "drop", 134.0, 39.0),
    ("yard-1", "pick", 54.0, 18.0), ("rack-4", "drop", 38.0, 18.0), ("goods-out-3", "pick", 110.0, 21.0),
    ("goods-out-1", "pick", 122.0, 21.0), ("goods-out-2", "pick", 134.0, 21.0),
    ("parking-a", "park", 8.0, 42.0), ("parking-b", "park", 116.0, 12.0),
    ("charger-1", "charge", 13.0, 54.0), ("charger-2", "charge", 128.0, 12.0),
]  # fmt: skip


# ------------------------------------------------------------------------------------------- GeoJSON and site
def geographic(x: float, y: float) -> list[float]:
    """Longitude, latitude of site metres; good to a millimetre over the plant (ellipsoidal radii at the origin)."""
    a, e2, phi = 6378137.0, 0.00669437999014, math.radians(LATITUDE)
    w = 1 - e2 * math.sin(phi) ** 2
    meridian, normal = a * (1 - e2) / w**1.5, a / math.sqrt(w)
    north = y - x * x * math.tan(phi) / (2 * normal)
    latitude = LATITUDE + math.degrees(north / meridian)
    longitude = LONGITUDE + math.degrees(x / (normal * math.cos(phi)) * (1 + y * math.tan(phi) / normal))
    return [round(longitude, 9), round(latitude, 9)]


def geojson() -> dict:
    features = []
    for road in ROADS:
        n = max(2, math.ceil(road.length / 2) + 1) if road.bulge else 2
        line = [geographic(*road.at(road.length * i / (n - 1))[:2]) for i in range(n)]
        properties = {
            "id": road.id, "from": road.start, "to": road.end, "oneway": road.oneway,
            "speed_limit": road.speed, "width": ONE_WAY_WIDTH if road.oneway else 2 * LANE,
        }  # fmt: skip
        features.append({
            "type": "Feature", "properties": properties, "geometry": {"type": "LineString", "coordinates": line},
        })  # fmt: skip
    return {"type": "FeatureCollection", "features": features}


def site_toml(name: str, network: str) -> str:
    lines = [
        f'name = "{name}"', "", "[frame]", f"latitude = {LATITUDE}", f"longitude = {LONGITUDE}", "rotation = 0.0", "",
        "[network]", f'file = "{network}"', 'traffic = "right"',
    ]  # fmt: skip
    for place, kind, x, y in PLACES:
        lines += ["", "[[place]]", f'id = "{place}"', f'kind = "{kind}"', f"x = {x}", f"y = {y}"]
    zones = [
        ("hall-a", [[2, 0], [46, 0], [46, 60], [2, 60]], "covered = true"),
        ("hall-b", [[104, 6], [140, 6], [140, 54], [104, 54]], "covered = true"),
        ("gates", [[44, 2], [52, 2], [52, 58], [44, 58]], "speed_limit = 2.0"),
    ]
    for zone, polygon, what in zones:
        lines += ["", "[[zone]]", f'id = "{zone}"', f"polygon = {polygon}", what]
    for building, polygon, height in (
        ("hall-a", [[2, 0], [46, 0], [46, 60], [2, 60]], 9.0),
        ("hall-b", [[104, 6], [140, 6], [140, 54], [104, 54]], 8.0),
        ("office", [[62, 14], [76, 14], [76, 22], [62, 22]], 6.0),
    ):
        lines += ["", "[[building]]", f'id = "{building}"', f"polygon = {polygon}", f"height = {height}"]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------------------------------------- OpenDRIVE
@dataclass(frozen=True)
class Way:
    """A lane of a road in its direction of travel; ``lane`` is -1 along the road, +1 against it."""

    road: Road
    lane: int

    @property
    def leaves(self) -> str:
        return self.road.start if self.lane < 0 else self.road.end

    @property
    def reaches(self) -> str:
        return self.road.end if self.lane < 0 else self.road.start

    @property
    def width(self) -> float:
        return ONE_WAY_WIDTH if self.road.oneway else LANE

    def at(self, s: float) -> tuple[float, float, float, float]:
        """x, y, heading, z of the lane's centre, ``s`` metres of centre line from the way's own start."""
        along = s if self.lane < 0 else self.road.length - s
        x, y, h = self.road.at(along)
        t = 0.0 if self.road.oneway else (-LANE / 2 if self.lane < 0 else LANE / 2)
        x, y = x - t * math.sin(h), y + t * math.cos(h)
        return x, y, h + (0.0 if self.lane < 0 else math.pi), self.road.height(along)


def ways() -> list[Way]:
    return [Way(r, -1) for r in ROADS] + [Way(r, 1) for r in ROADS if not r.oneway]


def turns() -> list[tuple[Way, Way]]:
    """Every way and what may follow it: anything that leaves the node but its own way back."""
    all_ways = ways()
    return [(a, b) for a in all_ways for b in all_ways if a.reaches == b.leaves and a.road is not b.road]


def turn_curve(a: Way, b: Way) -> list[tuple[float, float]]:
    """Control points of the quadratic Bezier from the end of ``a`` to the start of ``b``."""
    x0, y0, h0, _ = a.at(a.road.length - CUT)
    x2, y2, h2, _ = b.at(CUT)
    cross = math.sin(h2 - h0)
    if abs(cross) < 0.05:
        return [(x0, y0), ((x0 + x2) / 2, (y0 + y2) / 2), (x2, y2)]
    u = ((x2 - x0) * math.sin(h2) - (y2 - y0) * math.cos(h2)) / cross
    return [(x0, y0), (x0 + u * math.cos(h0), y0 + u * math.sin(h0)), (x2, y2)]


def bezier_length(p: list[tuple[float, float]], n: int = 200) -> float:
    points = [bezier(p, i / n) for i in range(n + 1)]
    return sum(math.dist(q, r) for q, r in pairwise(points))


def bezier(p: list[tuple[float, float]], t: float) -> tuple[float, float]:
    return tuple((1 - t) ** 2 * a + 2 * t * (1 - t) * b + t * t * c for a, b, c in zip(*p, strict=True))


def num(v: float) -> str:
    return f"{v:.10g}"


def lane_xml(lane: int, width: str, link: str = "") -> str:
    return f'<lane id="{lane}" type="driving" level="false"><link>{link}</link>{width}</lane>'


def road_xml(road: Road, junction_of: dict[str, int]) -> str:
    x, y, h = road.at(CUT)
    length = road.length - 2 * CUT
    shape = "<line/>" if not road.bulge else f'<arc curvature="{num(road.curvature)}"/>'
    if road.ramp:
        c, d = 3 * RAMP_HEIGHT / length**2, -2 * RAMP_HEIGHT / length**3
        elevation = f'<elevation s="0" a="0" b="0" c="{num(c)}" d="{num(d)}"/>'
    else:
        elevation = f'<elevation s="0" a="{num(road.height(0))}" b="0" c="0" d="0"/>'
    width = ONE_WAY_WIDTH if road.oneway else LANE
    record = f'<width sOffset="0" a="{num(width)}" b="0" c="0" d="0"/>'
    offset = f'<laneOffset s="0" a="{num(width / 2 if road.oneway else 0)}" b="0" c="0" d="0"/>'
    left = "" if road.oneway else f"<left>{lane_xml(1, record)}</left>"
    return (
        f'<road name={quoteattr(road.id)} length="{num(length)}" id="{road.number}" junction="-1" rule="RHT">'
        f'<link><predecessor elementType="junction" elementId="{junction_of[road.start]}"/>'
        f'<successor elementType="junction" elementId="{junction_of[road.end]}"/></link>'
        f'<type s="0" type="town"><speed max="{road.speed}" unit="m/s"/></type>'
        f'<planView><geometry s="0" x="{num(x)}" y="{num(y)}" hdg="{num(h)}" length="{num(length)}">{shape}</geometry></planView>'
        f"<elevationProfile>{elevation}</elevationProfile>"
        f'<lanes>{offset}<laneSection s="0">{left}<center><lane id="0" type="none" level="false"/></center>'
        f"<right>{lane_xml(-1, record)}</right></laneSection></lanes></road>"
    )


def turn_xml(number: int, junction: int, a: Way, b: Way) -> str:
    p = turn_curve(a, b)
    length = bezier_length(p)
    h = a.at(a.road.length - CUT)[2]
    c, s = math.cos(h), math.sin(h)
    local = [((x - p[0][0]) * c + (y - p[0][1]) * s, -(x - p[0][0]) * s + (y - p[0][1]) * c) for x, y in p]
    (_, _), (u1, v1), (u2, v2) = local
    poly = (
        f'<paramPoly3 aU="0" bU="{num(2 * u1)}" cU="{num(u2 - 2 * u1)}" dU="0" '
        f'aV="0" bV="{num(2 * v1)}" cV="{num(v2 - 2 * v1)}" dV="0" pRange="normalized"/>'
    )
    slope = (b.width - a.width) / length
    z = a.at(a.road.length - CUT)[3]
    speed = min(a.road.speed, b.road.speed)
    before, after = ("end" if a.lane < 0 else "start"), ("start" if b.lane < 0 else "end")
    link = f'<predecessor id="{a.lane}"/><successor id="{b.lane}"/>'
    return (
        f'<road name="" length="{num(length)}" id="{number}" junction="{junction}" rule="RHT">'
        f'<link><predecessor elementType="road" elementId="{a.road.number}" contactPoint="{before}"/>'
        f'<successor elementType="road" elementId="{b.road.number}" contactPoint="{after}"/></link>'
        f'<type s="0" type="town"><speed max="{speed}" unit="m/s"/></type>'
        f'<planView><geometry s="0" x="{num(p[0][0])}" y="{num(p[0][1])}" hdg="{num(h)}" length="{num(length)}">{poly}</geometry></planView>'
        f'<elevationProfile><elevation s="0" a="{num(z)}" b="0" c="0" d="0"/></elevationProfile>'
        f'<lanes><laneOffset s="0" a="{num(a.width / 2)}" b="{num(slope / 2)}" c="0" d="0"/><laneSection s="0">'
        f'<center><lane id="0" type="none" level="false"/></center><right>'
        f'{lane_xml(-1, f"""<width sOffset="0" a="{num(a.width)}" b="{num(slope)}" c="0" d="0"/>""", link)}</right></laneSection></lanes></road>'
    )


def opendrive() -> str:
    junction_of = {node: 1000 + i for i, node in enumerate(NODES)}
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>\n<OpenDRIVE><header revMajor="1" revMinor="6" name="sample plant" version="1.00">'
        f"<geoReference><![CDATA[+proj=aeqd +lat_0={LATITUDE} +lon_0={LONGITUDE} +ellps=WGS84 +units=m +no_defs]]></geoReference></header>"
    ]
    parts += [road_xml(road, junction_of) for road in ROADS]
    connections: dict[str, list[str]] = {node: [] for node in NODES}
    for number, (a, b) in enumerate(turns(), start=2000):
        parts.append(turn_xml(number, junction_of[a.reaches], a, b))
        connections[a.reaches].append(
            f'<connection id="{len(connections[a.reaches])}" incomingRoad="{a.road.number}" connectingRoad="{number}" '
            f'contactPoint="start"><laneLink from="{a.lane}" to="-1"/></connection>'
        )
    for node, junction in junction_of.items():
        parts.append(f'<junction name="{node}" id="{junction}">{"".join(connections[node])}</junction>')
    return "\n".join(parts) + "\n</OpenDRIVE>\n"


def main() -> None:
    (HERE / "roads.geojson").write_text(
        json.dumps(geojson(), separators=(",", ":")).replace('{"type":"Feature",', '\n{"type":"Feature",')
        + "\n"
    )
    (HERE / "plant.xodr").write_text(opendrive())
    (HERE / "site.toml").write_text(site_toml("sample plant", "roads.geojson"))
    (HERE / "site_3d.toml").write_text(site_toml("sample plant", "plant.xodr"))


if __name__ == "__main__":
    main()
