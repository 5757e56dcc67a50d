"""MCAP files and bags written by independent writers: the values come back, damage is survived, nothing hangs."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_reading import read_log

from fleetlog.errors import FleetlogError
from fleetlog.importers import mcap as mcap_importer
from fleetlog.importers._open import Damaged, unpack

START = 1_772_431_200  # 2026-03-02T06:00:00Z
HEADER = "std_msgs/Header header\n"
DEPENDENCIES = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
================================================================================
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
================================================================================
MSG: sensor_msgs/NavSatStatus
int8 status
uint16 service
"""
DEFINITIONS = {
    "sensor_msgs/msg/NavSatFix": HEADER + "sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
    "float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n",
    "nav_msgs/msg/Odometry": HEADER + "string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist\n",
    "geometry_msgs/msg/PoseStamped": HEADER + "geometry_msgs/Pose pose\n",
    "geometry_msgs/msg/PoseWithCovarianceStamped": HEADER + "geometry_msgs/PoseWithCovariance pose\n",
    "sensor_msgs/msg/BatteryState": HEADER + "float32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\n"
    "float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\nuint8 power_supply_health\n"
    "uint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\nfloat32[] cell_temperature\nstring location\n"
    "string serial_number\n",
}  # fmt: skip
YAW = 0.7
TURN = {"x": 0.0, "y": 0.0, "z": math.sin(YAW / 2), "w": math.cos(YAW / 2)}


def header(i: int, frame: str = "map") -> dict[str, Any]:
    return {"stamp": {"sec": START + i, "nanosec": 250_000_000}, "frame_id": frame}


def pose(i: int) -> dict[str, Any]:
    return {"position": {"x": 0.5 * i, "y": -1.0, "z": 0.25}, "orientation": TURN}


def message(kind: str, i: int) -> dict[str, Any]:
    covariance = {"covariance": [0.0] * 36}
    if kind.endswith("NavSatFix"):
        return {"header": header(i, "gps" * (i % 4)), "status": {"status": -1 if i == 3 else 0, "service": 1}, "latitude": 49.9 + i * 1e-5,
                "longitude": 9.1, "altitude": 120.5, "position_covariance": [0.0] * 9, "position_covariance_type": 0}  # fmt: skip
    if kind.endswith("Odometry"):
        twist = {"linear": {"x": 1.5, "y": 2.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.1}}
        return {"header": header(i), "child_frame_id": "base" * (i % 3), "pose": {"pose": pose(i), **covariance},
                "twist": {"twist": twist, **covariance}}  # fmt: skip
    if kind.endswith("PoseStamped"):
        return {"header": header(i), "pose": pose(i)}
    if kind.endswith("PoseWithCovarianceStamped"):
        return {"header": header(i), "pose": {"pose": pose(i), **covariance}}
    return {"header": header(i), "voltage": 48.5, "temperature": 31.0, "current": -20.0, "charge": math.nan, "capacity": math.nan,
            "design_capacity": math.nan, "percentage": 0.75, "power_supply_status": 2, "power_supply_health": 1,
            "power_supply_technology": 2, "present": True, "cell_voltage": [], "cell_temperature": [], "location": "", "serial_number": "7"}  # fmt: skip


def write_ros2(path: Path, topics: dict[str, str], n: int = 20, **options: Any) -> None:
    writer_module = pytest.importorskip("mcap_ros2.writer")
    with path.open("wb") as stream:
        writer = writer_module.Writer(stream, **options)
        schemas = {k: writer.register_msgdef(k, DEFINITIONS[k] + DEPENDENCIES) for k in set(topics.values())}
        for i in range(n):
            for topic, kind in topics.items():
                writer.write_message(topic, schemas[kind], message(kind, i), log_time=(START + i) * 10**9)
        writer.finish()


POSES = [
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
]


@pytest.mark.parametrize("kind", POSES)
def test_poses_of_ros2(kind: str, tmp_path: Path) -> None:
    write_ros2(tmp_path / "a.mcap", {"/T07/where": kind, "/T07/battery": "sensor_msgs/msg/BatteryState"})
    read = read_log(tmp_path / "a.mcap")
    assert (read.rows, read.channel_rows, read.vehicles, read.status) == (20, 20, {"T07"}, 0)
    np.testing.assert_allclose(read.column("x"), 0.5 * np.arange(20))
    np.testing.assert_allclose(read.column("heading"), YAW)
    np.testing.assert_array_equal(read.column("time"), (START + np.arange(20)) * 1_000_000 + 250_000)
    assert set(read.column("battery_current")) == {20.0}  # discharging is positive here
    assert set(read.column("soc")) == {0.75}
    if kind.endswith("Odometry"):
        np.testing.assert_allclose(read.column("speed"), 2.5)


def test_fixes_of_ros2_by_vehicle(tmp_path: Path) -> None:
    fix, battery = "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/BatteryState"
    write_ros2(
        tmp_path / "a.mcap",
        {"/T1/gps/fix": fix, "/T2/gps/fix": fix, "/T1/battery": battery, "/T2/odom": POSES[0]},
    )
    read = read_log(tmp_path / "a.mcap")
    assert read.vehicles == {"T1", "T2"}
    assert read.rows == 38  # one in twenty says that it has no fix
    assert read.channel_rows == 40  # a battery, and the speed of the odometry
    assert not read.rejects
    np.testing.assert_allclose(read.column("longitude"), 9.1)
    assert any("without a fix" in n for n in read.report.notes)
    assert any("only the speed of topic /T2/odom" in n for n in read.report.notes)


def test_big_endian_and_ros1_layouts() -> None:
    """The same pose in the three serialisations, packed by hand from their definitions."""
    from fleetlog.importers._messages import KINDS

    decode = KINDS["geometry_msgs/PoseStamped"].decode
    doubles = (1.0, 2.0, 3.0, *TURN.values())
    little = b"\x00\x01\x00\x00" + struct.pack("<iII4s7d", START, 5000, 4, b"map\0", *doubles)
    big = b"\x00\x00\x00\x00" + struct.pack(">iII4s7d", START, 5000, 4, b"map\0", *doubles)
    packed = struct.pack("<IIII3s7d", 9, START, 5000, 3, b"map", *doubles)
    samples = [decode["cdr"](little), decode["cdr"](big), decode["ros1"](packed)]
    assert samples[0] == samples[1] == samples[2]
    assert samples[0].stamp == START * 1_000_000 + 5
    assert samples[0].values["heading"] == pytest.approx(YAW)


LINK = "geometry_msgs/TransformStamped[] transforms\n"
LINKED = (
    DEPENDENCIES
    + 80 * "="
    + """
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
"""
)


def link(parent: str, child: str, shift: Any, turn: Any, i: int = 0) -> dict[str, Any]:
    transform = {
        "translation": dict(zip("xyz", shift, strict=True)),
        "rotation": dict(zip("xyzw", turn, strict=True)),
    }
    return {"header": header(i, parent), "child_frame_id": child, "transform": transform}


def write_links(path: Path, messages: list[tuple[str, list[dict[str, Any]]]]) -> None:
    writer_module = pytest.importorskip("mcap_ros2.writer")
    with path.open("wb") as stream:
        writer = writer_module.Writer(stream)
        schema = writer.register_msgdef("tf2_msgs/msg/TFMessage", LINK + LINKED)
        for i, (topic, links) in enumerate(messages):
            writer.write_message(topic, schema, {"transforms": links}, log_time=(START + i) * 10**9)
        writer.finish()


def test_transforms_compose_as_matrices_do(tmp_path: Path) -> None:
    """Random trees against products of 4 x 4 matrices; the turns of scipy are the authority."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(3)
    turns, shifts = Rotation.random(60, random_state=rng), rng.uniform(-50, 50, (60, 3))
    matrix = np.tile(np.eye(4), (60, 1, 1))
    matrix[:, :3, :3], matrix[:, :3, 3] = turns.as_matrix(), shifts
    quaternions = turns.as_quat()
    messages = []
    for i in range(20):
        tree = (("/map", "odom"), ("odom", "base_footprint"), ("base_footprint", "base_link"))
        links = [link(*names, shifts[3 * i + k], quaternions[3 * i + k], i) for k, names in enumerate(tree)]
        messages += [("/tf_static", links[:1]), ("/tf", links[1:])]
    write_links(tmp_path / "a.mcap", messages)
    read = read_log(tmp_path / "a.mcap")
    whole = matrix[0::3] @ matrix[1::3]
    assert (read.rows, read.vehicles, read.status) == (20, {"a"}, 0)
    for name, k in (("x", 0), ("y", 1), ("z", 2)):
        np.testing.assert_allclose(read.column(name), whole[:, k, 3], atol=1e-9)
    np.testing.assert_allclose(read.column("heading"), np.arctan2(whole[:, 1, 0], whole[:, 0, 0]), atol=1e-9)
    np.testing.assert_array_equal(read.column("time"), (START + np.arange(20)) * 1_000_000 + 250_000)


STILL = (0.0, 0.0, 0.0, 1.0)


def test_robots_of_one_tree_are_vehicles(tmp_path: Path) -> None:
    links = [
        link("map", f"{robot}/base_link", (i, k, 0), STILL, i)
        for i in range(5)
        for k, robot in enumerate(("R1", "R2"))
    ]
    write_links(tmp_path / "a.mcap", [("/tf", [one]) for one in links])
    assert read_log(tmp_path / "a.mcap").vehicles == {"R1", "R2"}


@pytest.mark.parametrize("placed", [False, True])
def test_odometry_alone_counts_only_without_a_map(placed: bool, tmp_path: Path) -> None:
    driven = [("/tf", [link("odom", "base_link", (i, 0, 0), STILL, i)]) for i in range(20)]
    if placed:
        driven.insert(5, ("/tf", [link("map", "odom", (100, 0, 0), STILL)]))
    write_links(tmp_path / "a.mcap", driven)
    read = read_log(tmp_path / "a.mcap")
    assert read.column("x").tolist() == ([100.0 + i for i in range(5, 20)] if placed else list(range(20)))
    assert any("5 poses" in note for note in read.report.notes) is placed


def test_frames_in_a_circle_are_one_rejected_message(tmp_path: Path) -> None:
    circle = [
        link("a", "b", (0, 0, 0), STILL),
        link("b", "a", (0, 0, 0), STILL),
        link("a", "base_link", (0, 0, 0), STILL),
    ]
    good = [("/tf", [link("map", "base_link", (i, 0, 0), STILL, i)]) for i in range(3)]
    write_links(tmp_path / "a.mcap", [*good, ("/tf", circle)])
    read = read_log(tmp_path / "a.mcap")
    assert read.rows == 3
    assert read.rejects == {"/tf: message cannot be decoded": 1}


def test_protobuf_of_foxglove(tmp_path: Path) -> None:
    foxglove = pytest.importorskip("foxglove")
    from foxglove.channels import LocationFixChannel
    from foxglove.messages import LocationFix, Timestamp

    path = tmp_path / "a.mcap"
    with foxglove.open_mcap(path):
        channels = [LocationFixChannel(f"/T{v}/fix") for v in (1, 2)]
        for i in range(50):
            for channel in channels:
                stamp = Timestamp(sec=START + i, nsec=500_000_000)
                channel.log(LocationFix(timestamp=stamp, frame_id="gps", latitude=49.9 + i * 1e-5, longitude=-9.1, altitude=0.0),
                            log_time=(START + i) * 10**9)  # fmt: skip
    read = read_log(path)
    assert (read.rows, read.vehicles, read.status) == (100, {"T1", "T2"}, 0)
    assert read.column("latitude").min() == 49.9
    assert set(read.column("longitude")) == {-9.1}
    assert read.column("time").min() == START * 1_000_000 + 500_000


def write_rosbag(path: Path, version: int, compression: str | None = None) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if version == 1 else typesys.Stores.ROS2_HUMBLE)
    types = store.types

    def build(kind: str, i: int) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](START + i, 250_000_000)
        head = (
            types["std_msgs/msg/Header"](i, stamp, "map")
            if version == 1
            else types["std_msgs/msg/Header"](stamp, "map")
        )
        if kind.endswith("NavSatFix"):
            status = types["sensor_msgs/msg/NavSatStatus"](0, 1)
            return types[kind](head, status, 49.9 + i * 1e-5, 9.1, 120.5, np.zeros(9), 0)
        point, turn = (
            types["geometry_msgs/msg/Point"](0.5 * i, -1.0, 0.25),
            types["geometry_msgs/msg/Quaternion"](**TURN),
        )
        return types[kind](head, types["geometry_msgs/msg/Pose"](point, turn))

    pose_stamped = "geometry_msgs/msg/PoseStamped"
    kinds = {"/T1/fix": "sensor_msgs/msg/NavSatFix", "/T1/pose": pose_stamped, "/T2/pose": pose_stamped}
    if version == 1:
        from rosbags.rosbag1 import Writer

        writer: Any = Writer(path)
        if compression:
            writer.set_compression(getattr(Writer.CompressionFormat, compression))
    else:
        from rosbags.rosbag2 import Writer as Writer2

        writer = Writer2(path, version=9)
    with writer:
        connections = {t: writer.add_connection(t, k, typestore=store) for t, k in kinds.items()}
        for i in range(200):
            for topic, kind in kinds.items():
                raw = (store.serialize_ros1 if version == 1 else store.serialize_cdr)(build(kind, i), kind)
                writer.write(connections[topic], (START + i) * 10**9, raw)


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_ros1_bag(compression: str | None, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    write_rosbag(path, 1, compression)
    read = read_log(path)
    assert (read.rows, read.status) == (400, 0)
    np.testing.assert_allclose(read.column("latitude").max(), 49.9 + 199e-5)
    np.testing.assert_allclose(read.column("heading"), YAW)
    data = path.read_bytes()
    for share in (0.9, 0.5):
        path.write_bytes(data[: int(len(data) * share)])
        try:
            cut = read_log(path)
        except FleetlogError as error:
            assert (
                compression or "nothing in it is whole" in error.line()
            )  # one chunk holds all: nothing is whole
        else:
            assert cut.rows <= 400 and (compression or share == 0.9 or cut.rows < 400)
            assert cut.status == 3


def test_ros2_bag_as_folder_and_file(tmp_path: Path) -> None:
    write_rosbag(tmp_path / "bag", 2)
    for path in (tmp_path / "bag", next((tmp_path / "bag").glob("*.db3"))):
        read = read_log(path)
        assert (read.rows, read.status) == (400, 0)


def test_a_bag_split_into_files_is_one_vehicle(tmp_path: Path) -> None:
    folder = tmp_path / "ride"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    for i in range(2):
        write_ros2(folder / f"ride_{i}.mcap", {"/fix": "sensor_msgs/msg/NavSatFix"})
    read = read_log(folder)
    assert (read.rows, read.vehicles) == (38, {"ride"})


def big_json(path: Path, compression: Any, n: int = 4000) -> None:
    """LocationFix as JSON in small chunks, by the mcap package's own writer."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=8 << 10, compression=compression)
        writer.start()
        schema = writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
        channel = writer.register_channel("/T1/fix", "json", schema)
        for i in range(n):
            text = json.dumps({"latitude": 49.9, "longitude": 9.1 + i * 1e-6, "n": i})
            writer.add_message(channel, (START + i) * 10**9, text.encode(), 0)
        writer.finish()


@pytest.mark.parametrize("packing", ["NONE", "LZ4", "ZSTD"])
def test_salvage(packing: str, tmp_path: Path) -> None:
    """Cut off: what is before the cut.  A bad chunk: all but that chunk.  A wrong record length: the index leads on."""
    from mcap.writer import CompressionType

    path = tmp_path / "a.mcap"
    big_json(path, CompressionType[packing])
    whole = path.read_bytes()
    assert read_log(path).rows == 4000

    for end in (len(whole) // 2, len(whole) - 4, len(whole) - 20):
        path.write_bytes(whole[:end])
        cut = read_log(path)
        assert cut.status == 3
        assert cut.rows > (1500 if end == len(whole) // 2 else 3990)

    middle = len(whole) // 3
    path.write_bytes(
        whole[:middle] + bytes(b ^ 0xFF for b in whole[middle : middle + 8]) + whole[middle + 8 :]
    )
    damaged = read_log(path)
    assert damaged.status == 3
    assert 3500 < damaged.rows < 4000
    assert any("of 4,000 are whole" in d for d in damaged.report.damage)

    from mcap.reader import make_reader

    with path.open("wb") as stream:
        stream.write(whole)
    with path.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[5].chunk_start_offset
    path.write_bytes(whole[: chunk + 1] + struct.pack("<Q", 1 << 60) + whole[chunk + 9 :])
    jumped = read_log(path)
    assert 3500 < jumped.rows < 4000


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    import bz2

    import lz4.frame
    import zstandard

    zeros = bytes(1 << 26)
    packers = {"zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}
    for name, pack in packers.items():
        with pytest.raises(Damaged):
            unpack(name, pack(zeros), 1 << 16)
        with pytest.raises(Damaged):
            unpack(name, pack(zeros[:100]), 1 << 40)
        assert unpack(name, pack(zeros[:100]), 100) == zeros[:100]


def test_topics_to_vehicles() -> None:
    from fleetlog.importers._topics import Topic, _vehicles

    fix, battery = "sensor_msgs/NavSatFix", "sensor_msgs/BatteryState"

    def vehicles(**topics: str) -> dict[str, str]:
        named = {k.replace("__", "/"): v for k, v in topics.items()}
        return _vehicles([Topic(n, s, "cdr") for n, s in named.items()], "file")

    assert set(vehicles(__T1__fix=fix, __T2__fix=fix, __T1__battery=battery).values()) == {"T1", "T2"}
    assert vehicles(__fleet__a__fix=fix, __fleet__b__fix=fix) == {"/fleet/a/fix": "a", "/fleet/b/fix": "b"}
    assert set(vehicles(__robot__fix=fix, __robot__battery=battery).values()) == {"robot"}
    assert set(vehicles(__gps__fix=fix, battery=battery).values()) == {"file"}
    assert set(vehicles(fix=fix).values()) == {"file"}


def test_wrong_magic_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no mcap at all")
    with pytest.raises(FleetlogError, match="not an MCAP"):
        read_log(tmp_path / "a.mcap", mcap_importer.IMPORTER)
