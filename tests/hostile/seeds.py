"""A small whole file for every reader, written by other people's writers where a format is binary."""

from __future__ import annotations

import io
import json
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

START = 1_772_427_600
"""2026-03-02T05:00:00Z."""
ROWS = 40


def iso(i: int) -> str:
    return f"2026-03-02T{5 + i // 3600:02d}:{i // 60 % 60:02d}:{i % 60:02d}Z"


def csv(rows: int = ROWS, end: str = "\n", header: str = "vehicle_id,timestamp,x,y,speed,soc,note") -> bytes:
    lines = [
        f"T{i % 2},{iso(i)},{0.5 * i:.2f},{-0.25 * i:.2f},0.56,{0.9 - 1e-4 * i:.4f},n{i}" for i in range(rows)
    ]
    return end.join([header, *lines, ""]).encode()


def gpx() -> bytes:
    points = "".join(
        f'<trkpt lat="{49.97 + i * 1e-5:.6f}" lon="9.151000"><ele>{100 + i}</ele><time>{iso(i)}</time>'
        f"<extensions><speed>1.5</speed></extensions></trkpt>\n"
        for i in range(ROWS)
    )
    return f'<?xml version="1.0"?>\n<gpx version="1.1"><trk><name>a</name><trkseg>\n{points}</trkseg></trk></gpx>'.encode()


def nmea() -> bytes:
    lines = []
    for i in range(ROWS):
        for body in (f"GPRMC,0500{i:02d}.00,A,4958.{1000 + i:04d}00,N,00909.060000,E,2.5,90.0,020326,,,A",
                     f"GPGGA,0500{i:02d}.00,4958.{1000 + i:04d}00,N,00909.060000,E,1,09,0.9,120.0,M,47.0,M,,"):  # fmt: skip
            check = 0
            for byte in body.encode():
                check ^= byte
            lines.append(f"${body}*{check:02X}\r\n")
    return "".join(lines).encode()


def tum() -> bytes:
    return b"".join(b"%d.5 %.2f 2.0 0.1 0 0 0 1\n" % (START + i, 0.5 * i) for i in range(ROWS))


def fcd() -> bytes:
    steps = "".join(
        f'<timestep time="{i}.00"><vehicle id="v" x="{0.5 * i:.2f}" y="2.00" angle="90.00" speed="0.50" lane="a_0"/></timestep>\n'
        for i in range(ROWS)
    )
    return f"<!-- fleetlog-epoch 2026-03-02T05:00:00Z -->\n<fcd-export>\n{steps}</fcd-export>".encode()


def vda() -> bytes:
    message: dict[str, Any] = {"headerId": 1, "version": "2.0.0", "manufacturer": "m", "serialNumber": "7"}
    return b"".join(
        json.dumps({**message, "timestamp": iso(i), "agvPosition": {"x": 0.5 * i, "y": 2.0, "theta": 0.0, "mapId": "a"},
                    "batteryState": {"batteryCharge": 80.0, "charging": False}, "loads": [{"weight": 100.0}]}).encode() + b"\n"
        for i in range(ROWS)
    )  # fmt: skip


def feature(i: int, **more: Any) -> dict[str, Any]:
    where = {"type": "Point", "coordinates": [9.151, 49.97 + i * 1e-5, 100.0]}
    return {
        "type": "Feature",
        "geometry": where,
        "properties": {"timestamp": iso(i), "speed": 1.5, "note": "n", **more},
    }


def collection(features: list[dict[str, Any]]) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": features}).encode()


def geojson() -> bytes:
    return collection([feature(i) for i in range(ROWS)])


def lines(count: int = 4, lists: int = 4) -> bytes:
    """A MultiLineString of ``count`` lines with times for the first ``lists`` of them."""
    per = ROWS // count
    parts = [[[9.151, 49.97 + (k * per + i) * 1e-5] for i in range(per)] for k in range(count)]
    times = [[iso(k * per + i) for i in range(per)] for k in range(lists)]
    geometry = {"type": "MultiLineString", "coordinates": parts}
    return collection([{"type": "Feature", "geometry": geometry, "properties": {"coordTimes": times}}])


def parquet(**columns: Any) -> bytes:
    """A table of pyarrow; a column given as None is left out."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stamps = pa.array([(START + i) * 1_000_000 for i in range(ROWS)], pa.timestamp("us", "UTC"))
    given = {"vehicle_id": ["T1"] * ROWS, "timestamp": stamps, "x": [0.5 * i for i in range(ROWS)], "y": [1.0] * ROWS,
             "speed": [0.5] * ROWS, "note": [f"n{i}" for i in range(ROWS)], **columns}  # fmt: skip
    out = io.BytesIO()
    pq.write_table(pa.table({k: v for k, v in given.items() if v is not None}), out)
    return out.getvalue()


@cache
def mcap(packing: str = "NONE", statistics: bool = True, rows: int = ROWS) -> bytes:
    from mcap.writer import CompressionType, IndexType, Writer

    out = io.BytesIO()
    index = IndexType.ALL if statistics else IndexType.NONE
    writer = Writer(out, chunk_size=600, compression=CompressionType[packing], index_types=index, use_statistics=statistics,
                    enable_crcs=packing != "NONE")  # fmt: skip
    writer.start()
    schema = writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
    channel = writer.register_channel("/T1/fix", "json", schema)
    for i in range(rows):
        text = json.dumps({"latitude": 49.97 + i * 1e-5, "longitude": 9.151})
        writer.add_message(channel, (START + i) * 10**9, text.encode(), 0)
    writer.finish()
    return out.getvalue()


def chunks(data: bytes) -> list[int]:
    """Places of the chunks in an MCAP file."""
    at, found = 8, []
    while at < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, at)
        found += [at] * (kind == 6)
        at += 9 + length
    return found


@cache
def bag(version: int = 1, packing: str = "") -> bytes:
    """A bag of ROS 1, or the SQLite file of one of ROS 2."""
    import numpy as np
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    kind, types = "sensor_msgs/msg/NavSatFix", store.types
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        if version == 1:
            from rosbags.rosbag1 import Writer

            writer: Any = Writer(path)
            if packing:
                writer.set_compression(getattr(Writer.CompressionFormat, packing))
        else:
            from rosbags.rosbag2 import Writer as Writer2

            writer = Writer2(path, version=9)
        with writer:
            connection = writer.add_connection("/T1/fix", kind, typestore=store)
            for i in range(ROWS):
                stamp = types["builtin_interfaces/msg/Time"](START + i, 0)
                head = types["std_msgs/msg/Header"](*([i, stamp, "gps"] if version == 1 else [stamp, "gps"]))
                status = types["sensor_msgs/msg/NavSatStatus"](0, 1)
                fix = types[kind](head, status, 49.97 + i * 1e-5, 9.151, 120.5, np.zeros(9), 0)
                raw = (store.serialize_ros1 if version == 1 else store.serialize_cdr)(fix, kind)
                writer.write(connection, (START + i) * 10**9, raw)
        return path.read_bytes() if version == 1 else next(path.glob("*.db3")).read_bytes()


def tcx() -> bytes:
    points = "".join(
        f"<Trackpoint><Time>{iso(i)}</Time><Position><LatitudeDegrees>{49.97 + i * 1e-5:.6f}</LatitudeDegrees>"
        f"<LongitudeDegrees>9.151</LongitudeDegrees></Position><AltitudeMeters>{100 + i}</AltitudeMeters></Trackpoint>\n"
        for i in range(ROWS)
    )
    return f"<TrainingCenterDatabase><Activities><Activity><Lap><Track>\n{points}</Track></Lap></Activity></Activities></TrainingCenterDatabase>".encode()


def kml() -> bytes:
    marks = "".join(
        f"<Placemark><TimeStamp><when>{iso(i)}</when></TimeStamp><Point><coordinates>9.151,{49.97 + i * 1e-5:.6f},{i}</coordinates>"
        f"</Point></Placemark>\n"
        for i in range(ROWS)
    )
    return f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n{marks}</Document></kml>'.encode()


def kitti() -> bytes:
    return b"".join(b"1 0 0 %d 0 1 0 2 0 0 1 0\n" % i for i in range(ROWS))


TIMES = b"".join(b"%.6e\n" % (START + i) for i in range(ROWS))
"""``times.txt``, which lies beside KITTI poses."""


def fit() -> bytes:
    """Record messages (FIT protocol 2.0) with time, position and altitude; without a checksum, which 0 states."""
    fields = [(253, 4, 0x86), (0, 4, 0x85), (1, 4, 0x85), (2, 2, 0x84)]
    body = struct.pack("<BBBHB", 0x40, 0, 0, 20, len(fields)) + b"".join(bytes(f) for f in fields)
    for i in range(ROWS):
        latitude, longitude = (round(v * 2**31 / 180.0) for v in (49.97 + i * 1e-5, 9.151))
        body += struct.pack("<BIiiH", 0, START - 631_065_600 + i, latitude, longitude, (120 + 500) * 5)
    return struct.pack("<BBHI4sH", 14, 0x20, 2100, len(body), b".FIT", 0) + body + bytes(2)


def carla() -> bytes:
    """A log as CARLA's recorder lays it out: one car and a walker, a frame a second."""

    def text(value: str) -> bytes:
        return struct.pack("<H", len(value)) + value.encode()

    def packet(kind: int, data: bytes) -> bytes:
        return struct.pack("<BI", kind, len(data)) + data

    out = struct.pack("<H", 1) + text("CARLA_RECORDER") + struct.pack("<q", START) + text("Town03")
    for i in range(ROWS):
        out += packet(0, struct.pack("<Qdd", i + 1, 1.0, float(i)))
        if i == 0:
            names = ((27, 1, "vehicle.a"), (28, 2, "walker.b"))
            added = b"".join(
                struct.pack("<IB6fI", n, kind, *[0.0] * 6, 9)
                + text(name)
                + struct.pack("<HB", 1, 3)
                + text("a")
                + text("b")
                for n, kind, name in names
            )
            out += packet(2, struct.pack("<H", 2) + added)
        places = b"".join(struct.pack("<I6f", n, 50.0 * i, 2.0, 0.0, 0.0, 0.0, 90.0) for n in (27, 28))
        out += packet(6, struct.pack("<H", 2) + places) + packet(1, b"")
    return out


@cache
def osi() -> bytes:
    from osi3.osi_groundtruth_pb2 import GroundTruth

    out = b""
    for i in range(ROWS):
        said = GroundTruth()
        said.version.version_major = 3
        said.timestamp.seconds = START + i
        for number in (1, 2):
            o = said.moving_object.add()
            o.id.value, o.type = number, 2
            o.base.position.x, o.base.position.y, o.base.velocity.x = 0.5 * i, float(number), 0.5
        data = said.SerializeToString()
        out += struct.pack("<I", len(data)) + data
    return out


@cache
def mf4() -> bytes:
    import numpy as np
    from asammdf import MDF, Signal

    at = np.arange(float(ROWS))
    with tempfile.TemporaryDirectory() as folder, MDF(version="4.10") as out:
        out.append([Signal(0.5 * at, at, name=n, unit="m") for n in "xy"])
        out.append([Signal(0.9 - 0.01 * at, at, name="soc"), Signal(at, at, name="tilt")])
        out.save(Path(folder) / "a.mf4")
        return (Path(folder) / "a.mf4").read_bytes()


LOGS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "csv": ("csv", csv), "gpx": ("gpx", gpx), "nmea": ("nmea", nmea), "tum": ("tum", tum), "sumo-fcd": ("xml", fcd),
    "vda5050": ("jsonl", vda), "geojson": ("geojson", geojson), "geojson lines": ("geojson", lines),
    "parquet": ("parquet", parquet), "mcap": ("mcap", mcap), "mcap zstd": ("mcap", lambda: mcap("ZSTD")),
    "mcap lz4": ("mcap", lambda: mcap("LZ4")), "rosbag": ("bag", bag), "rosbag bz2": ("bag", lambda: bag(1, "BZ2")),
    "rosbag ros2": ("db3", lambda: bag(2)), "tcx": ("tcx", tcx), "kml": ("kml", kml),
}  # fmt: skip
"""Name: suffix, and the bytes of a file of 40 rows."""
MORE_LOGS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "kitti": ("txt", kitti), "fit": ("fit", fit), "carla": ("log", carla), "osi": ("osi", osi), "mf4": ("mf4", mf4),
}  # fmt: skip
EXTRAS = {"fit": "fitdecode", "osi": "osi3", "mf4": "asammdf"}
"""The module without which a reader does not read."""
"""Logs that need a file beside them, or a package that may be missing."""

ROAD = {"type": "Feature", "properties": {"id": "r", "speed_limit": 3.0},
        "geometry": {"type": "LineString", "coordinates": [[9.15, 49.97, 1.0], [9.151, 49.97, 2.0]]}}  # fmt: skip
OPENDRIVE = """<?xml version="1.0"?>
<OpenDRIVE><header revMajor="1" revMinor="6"/><road id="1" length="40" junction="-1" rule="RHT"><link/>
<planView><geometry s="0" x="0" y="0" hdg="0" length="10"><line/></geometry>
<geometry s="10" x="10" y="0" hdg="0" length="10"><arc curvature="0.05"/></geometry>
<geometry s="20" x="19.6" y="2.4" hdg="0.5" length="10"><spiral curvStart="0.05" curvEnd="0"/></geometry>
<geometry s="30" x="28" y="7" hdg="0.7" length="10"><paramPoly3 pRange="normalized" aU="0" bU="10" cU="0" dU="0" aV="0" bV="0" cV="1" dV="0"/>
</geometry></planView><elevationProfile><elevation s="0" a="1" b="0.01" c="0" d="0"/></elevationProfile>
<lanes><laneSection s="0"><left/><center><lane id="0" type="none"/></center><right><lane id="-1" type="driving"><link/>
<width sOffset="0" a="3" b="0" c="0" d="0"/><speed sOffset="0" max="30" unit="km/h"/></lane></right></laneSection></lanes></road></OpenDRIVE>"""
OSM = """<?xml version="1.0"?><osm version="0.6"><node id="1" lat="49.97" lon="9.15"/><node id="2" lat="49.971" lon="9.15"/>
<node id="3" lat="49.972" lon="9.151"/><way id="7"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="service"/>
<tag k="maxspeed" v="20"/><tag k="width" v="3.5"/></way></osm>"""
GRAPHML = """<?xml version="1.0"?><graphml xmlns="http://graphml.graphdrawing.org/xmlns"><key id="x" for="node" attr.name="x"/>
<key id="y" for="node" attr.name="y"/><key id="g" for="edge" attr.name="geometry"/><key id="c" for="graph" attr.name="crs"/><graph>
<data key="c">epsg:4326</data><node id="1"><data key="x">9.15</data><data key="y">49.97</data></node>
<node id="2"><data key="x">9.151</data><data key="y">49.97</data></node>
<edge source="1" target="2" id="0"><data key="g">LINESTRING (9.15 49.97, 9.1505 49.9702, 9.151 49.97)</data></edge></graph></graphml>"""
OPENTCS = """<?xml version="1.0"?><model version="6.0.0" name="m"><point name="A" positionX="0" positionY="0" positionZ="0" type="HALT_POSITION"/>
<point name="B" positionX="9000" positionY="0" positionZ="0" type="PARK_POSITION"/><path name="p" sourcePoint="A" destinationPoint="B"
length="9000" maxVelocity="1000" maxReverseVelocity="1000" locked="false"/></model>"""
SUMO = """<?xml version="1.0"?><net version="1.20"><location netOffset="0.00,0.00" projParameter="!"/><edge id="a" from="1" to="2">
<lane id="a_0" index="0" speed="5.00" length="10.00" shape="0.00,0.00 10.00,0.00"/></edge></net>"""
CURVE = {"degree": 2, "knotVector": [0, 0, 0, 1, 1, 1],
         "controlPoints": [{"x": 10, "y": 0}, {"x": 20, "y": 0, "weight": 0.7}, {"x": 20, "y": 10}]}  # fmt: skip
LIF = {"metaInformation": {"lifVersion": "2.0.0"}, "layouts": [{
    "layoutId": "1", "nodes": [{"nodeId": n, "nodePosition": {"x": x, "y": y}} for n, x, y in (("A", 0, 0), ("B", 10, 0), ("C", 20, 10))],
    "edges": [{"edgeId": "e1", "startNodeId": "A", "endNodeId": "B", "mobileRobotTypeEdgeProperties": [{"maximumSpeed": 1.5}]},
              {"edgeId": "e2", "startNodeId": "B", "endNodeId": "C", "vehicleTypeEdgeProperties": [{"maxSpeed": 1.0, "trajectory": CURVE}]}],
    "stations": []}]}  # fmt: skip
GRAPH = b"""building_name: b
levels:
  L1:
    lanes:
    - [0, 1, {speed_limit: 0.5}]
    - [1, 0, {}]
    vertices:
    - [0.0, 0.0, {name: dock, is_charger: true}]
    - [10.0, 0.0, {name: ''}]
"""
BUILDING = b"""coordinate_system: reference_image
levels:
  L1:
    drawing: {filename: a.png}
    lanes:
      - [0, 1, {bidirectional: [4, true], graph_idx: [2, 0]}]
    measurements:
      - [0, 1, {distance: [3, 10]}]
    vertices:
      - [0, 0, 0, dock, {is_charger: [4, true]}]
      - [200, 0, 0, ""]
"""
MAPS: dict[str, bytes] = {
    "map.geojson": collection([ROAD]), "map.xodr": OPENDRIVE.encode(), "map.osm": OSM.encode(),
    "map.graphml": GRAPHML.encode(), "map.json": json.dumps(LIF).encode(), "model.xml": OPENTCS.encode(),
    "map.net.xml": SUMO.encode(), "graph.yaml": GRAPH, "a.building.yaml": BUILDING,
}  # fmt: skip

TRUCK = b"""name = "t"
[chassis]
mass = 4900.0
rated_load = 2500.0
[drive]
efficiency = 0.8
max_speed = 5.0
[battery]
voltage = 48.0
capacity_wh = 30000.0
"""
SITE = b"""name = "works"
[frame]
latitude = 49.97
longitude = 9.15
rotation = 0.1
[network]
file = "map.geojson"
traffic = "left"
[[place]]
id = "p"
kind = "charge"
x = 1.0
y = 2.0
plugs = 3
power = 9000.0
[[zone]]
id = "z"
polygon = [[0, 0], [10, 0], [10, 10]]
speed_limit = 2.0
covered = true
[[building]]
polygon = [[0, 0], [10, 0], [10, 10]]
height = 8.0
"""
PROFILE = b"""delimiter = ","
decimal = "."
encoding = "utf-8"
skip_lines = 0
comment = "%"
sentinels = ["n/a", -9999]
vehicle = "{stem}"
keep = true
[time]
column = "timestamp"
format = "iso"
zone = "Europe/Berlin"
[columns]
speed = { column = "speed", unit = "km/h", scale = 1.0, sentinels = [-1] }
payload = "note"
"""
MODEL = b"""format_version = 1
truck = "t"
off = ["wind"]
[term.auxiliary_load]
power = 661.0
[term.rolling_resistance]
coefficient = 0.02
[interval.auxiliary_load]
power = [640.0, 690.0]
"""
TARIFF = b"""currency = "EUR"
price = 0.31
co2 = 0.4
charger_efficiency = 0.9
[[period]]
name = "night"
from = 22
to = 6
days = ["mon", "sun"]
price = 0.2
"""
TASKS = b"vehicle,from,to,payload,earliest\nT1,p,q,500,0\n,q,p,700,10.5\n"
EXPERIMENT = b"""vehicles = 3
duration = "60s"
truck = "counterbalance-2.5t"
close = ["r"]
shadow = false
[vary]
plugs = [2, 3]
policy = ["opportunity", "threshold"]
"""
SETTINGS = {
    "truck.toml": TRUCK, "site.toml": SITE, "profile.toml": PROFILE, "model.toml": MODEL, "tariff.toml": TARIFF,
    "tasks.csv": TASKS, "experiment.toml": EXPERIMENT,
}  # fmt: skip
