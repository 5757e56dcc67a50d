"""Every real log: read with a known count, or refused in one clear line.  A new file there fails until it stands here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from log_reading import read_log

from fleetlog.errors import FleetlogError
from fleetlog.importers._open import ReadReport
from fleetlog.importers.base import ReadOptions, detect, find

# Rows with a position, or a part of the refusal.  The counts of GPX are compared with gpxpy below.
EXPECTED: dict[str, int | str] = {
    "gpx/Mojstrovka.gpx": 184, "gpx/around-visnjan-with-car.gpx": 104, "gpx/cerknicko-jezero-with-elevations-zero.gpx": 296,
    "gpx/cerknicko-jezero-without-elevations.gpx": 295, "gpx/cerknicko-without-times.gpx": 5, "gpx/first_and_last_elevation.gpx": 10,
    "gpx/gpx-with-node-with-comments.gpx": 1, "gpx/gpx1.1_with_all_fields.gpx": 1, "gpx/korita-zbevnica.gpx": 513,
    "gpx/track-with-empty-segment.gpx": 9, "gpx/track-with-extremes.gpx": "point without a time",
    "gpx/track-with-small-floats.gpx": "point without a time", "gpx/track_with_dilution_errors.gpx": "point without a time",
    "gpx/custom_schema_locations.gpx": "no track point", "gpx/gpx1.1_with_extensions.gpx": "only 1 waypoint",
    "gpx/gpx_with_garmin_extension.gpx": "only 1 waypoint", "gpx/unicode.gpx": "only 6 waypoints",
    "gpx/unicode2.gpx": "no track point", "gpx/unicode_with_bom_noencoding.gpx": "only 1 waypoint",
    "mcap/locationfix_json.mcap": 51, "mcap/bag_with_topics_and_service_events.mcap": "none of its 5 topics carries a position",
    "mcap/cdr_test_0.mcap": "none of its 2 topics", "mcap/talker.mcap": "std_msgs/msg/String",
    "mcap/topics_and_services.mcap": "AddTwoInts_Event", "mcap/wrong_rmw_test_0.mcap": "wrong_format",
    "rosbag/empty-file.bag": "the file is empty", "rosbag/empty_bag_0.db3": "none of its 2 topics",
    "rosbag/example.bag": 2688, "rosbag/example-bz2.bag": 2688, "rosbag/example-lz4.bag": 2688,
    "rosbag/no-messages.bag": "no topic", "rosbag/talker.db3": "std_msgs/msg/String",
    "ubx/pygpsdata-BADEOF2.log": 1, "ubx/pygpsdata-BADNMEAEOF.log": 2, "ubx/pygpsdata-MIXED-RTCM3BADCRC.log": 2,
    "ubx/pygpsdata-MIXED.log": 39, "ubx/pygpsdata-MIXED3BADCK.log": 2, "ubx/pygpsdata-NAV.log": 1,
    "ubx/pygpsdata-NMEA.log": "no date",
    "nmea/eXplorist110.log": "no fix in any of its 27 moments", "nmea/furuno_nmea.log": "no sentence with a position",
    "nmea/pygpsdata-maritime.log": "no sentence with a position", "nmea/septentriox5_nmea.log": "no sentence with a position",
    "nmea/skytraq.log": "no fix in any of its 17", "nmea/tn200.log": "no fix in any of its 19",
    "nmea/trimble_nmea.log": "no sentence with a position", "nmea/ublox-lea-5q.log": "no fix in any of its 9",
}  # fmt: skip
NMEA_COUNTS = [
    "ac12",
    "7",
    "ais-nmea",
    "164",
    "april6_2019",
    "1",
    "beidou-gb",
    "2",
    "bn-9015",
    "6",
    "bt451",
    "15",
    "bu353s4",
    "25",
    "cat-ms352",
    "40",
    "ch-4711",
    "7",
    "ericsson-gru04-02-70sec",
    "71",
    "et-332",
    "19",
    "foretrex-201",
    "7",
    "garmin-10x",
    "10",
    "garmin15x",
    "7",
    "garmin25lp",
    "10",
    "garmin48",
    "14",
    "gp-320fw-2019-03-28",
    "21",
    "gp-320fw-2019-04-07-coldboot",
    "2",
    "gpsdf",
    "51",
    "gr601-w",
    "10",
    "hab-gpspi",
    "3",
    "hemi",
    "21",
    "hp58534a",
    "2",
    "isync",
    "12",
    "magellan-ec10",
    "21",
    "meinberg-gps164",
    "70",
    "mr-350p",
    "14",
    "mtk-3301",
    "4",
    "myguide-3100",
    "9",
    "nd-1005",
    "16",
    "nl2008u",
    "9",
    "nl551e",
    "14",
    "nmea-rtk",
    "122",
    "oncore",
    "7",
    "polarx2",
    "5",
    "pygpsdata-badeof",
    "1",
    "pygpsdata-mixed",
    "2",
    "pygpsdata-nmeabadck",
    "1",
    "quectel-eg25-g-2",
    "3",
    "quectel-l76k-dual",
    "130",
    "quectel",
    "34",
    "quectelLC79D",
    "30",
    "rst39",
    "41",
    "saab-r4",
    "12",
    "skytraq-PX1172RH_DS",
    "9",
    "skytraq-fix",
    "11",
    "st-teseo-liv3f",
    "30",
    "tcp-torture",
    "1",
    "telit-pls83-w",
    "10",
    "tomtom-mkII",
    "4",
    "triton400",
    "5",
    "ublox-f9p-hpnmea",
    "9",
    "ublox-lea-4s",
    "3",
    "ublox-zed-f9p-nmea",
    "29",
    "ublox-zed-f9r",
    "30",
    "ublox8-uniqid-monhw",
    "8",
    "unicore-um621",
    "16",
]
EXPECTED |= {f"nmea/{n}.log": int(c) for n, c in zip(NMEA_COUNTS[::2], NMEA_COUNTS[1::2], strict=True)}
DAMAGED = {
    "gpx/cerknicko-jezero-without-elevations.gpx": "point without a time", "gpx/korita-zbevnica.gpx": "point without a time",
    "gpx/cerknicko-without-times.gpx": "point without a time",
    "nmea/april6_2019.log": "GPRMC: date cannot be read: 2208-1", "nmea/pygpsdata-nmeabadck.log": "checksum of the sentence is wrong",
    "nmea/gp-320fw-2019-04-07-coldboot.log": "checksum of the sentence is wrong",
    "nmea/tcp-torture.log": "GPGGA: time cannot be read: |19322|1.00",
    "ubx/pygpsdata-MIXED3BADCK.log": "checksum of the UBX message is wrong",
    "ubx/pygpsdata-BADEOF2.log": "the UBX message is cut off by the end of the file",
}  # fmt: skip


def test_all_files_are_listed(shared_data: Path) -> None:
    logs = shared_data / "logs"
    assert {str(p.relative_to(logs)) for p in logs.rglob("*") if p.is_file()} == set(EXPECTED)


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_real_log(name: str, shared_data: Path) -> None:
    path, expected = shared_data / "logs" / name, EXPECTED[name]
    if isinstance(expected, str):
        with pytest.raises(FleetlogError) as caught:
            read_log(path)
        line = caught.value.line()
        assert expected in line
        assert str(path) in line and "\n" not in line
        return
    read = read_log(path)
    assert read.rows == expected
    if name in DAMAGED:
        assert DAMAGED[name] in read.rejects
        assert read.status == 3


TRACES = {
    "test_trace.gpx": "point without a time", "test_trace.geojson": "16 points without a time",
    "test_trace_stationary_points.geojson": "20 points without a time", "trace_bad_start.geojson": "17 points without a time",
    "downtown_denver.geojson": "1 Polygon",
}  # fmt: skip


@pytest.mark.parametrize("name", TRACES)
def test_traces_without_times_are_refused(name: str, shared_data: Path) -> None:
    with pytest.raises(FleetlogError) as caught:
        read_log(shared_data / "mapmatch" / name)
    assert TRACES[name] in caught.value.line()


def test_traces_of_other_kinds(shared_data: Path) -> None:
    """The remaining traces and tables are CSV; the graph is a map."""
    for path in sorted((shared_data / "mapmatch").iterdir()):
        if path.name not in TRACES and path.suffix != ".graphml":
            assert detect(path).name == "csv", path.name
    graph = find(shared_data / "mapmatch" / "osmnx_drive_graph.graphml")
    assert graph is None
    for path in [*(shared_data / "tripviewer").iterdir(), *(shared_data / "escooter").iterdir()]:
        assert detect(path).name == "csv", path.name


@pytest.mark.parametrize("name", [n for n in EXPECTED if n.startswith("gpx/")])
def test_gpx_agrees_with_gpxpy(name: str, shared_data: Path) -> None:
    gpxpy = pytest.importorskip("gpxpy")
    text = (shared_data / "logs" / name).read_text(encoding="utf-8-sig")
    try:
        gpx = gpxpy.parse(text)
    except Exception as error:
        pytest.skip(f"gpxpy cannot read it: {error}")
    points = [p for t in gpx.tracks for s in t.segments for p in s.points if p.time is not None]
    if not points:
        assert isinstance(EXPECTED[name], str)
        return
    read = read_log(shared_data / "logs" / name)
    assert read.rows == len(points)
    assert read.column("latitude").tolist() == [p.latitude for p in points]
    assert read.column("longitude").tolist() == [p.longitude for p in points]
    seconds = [
        p.time.replace(tzinfo=None).timestamp() if p.time.tzinfo is None else p.time.timestamp()
        for p in points
    ]
    assert abs(read.column("time") / 1e6 - seconds).max() < 1e-3


def test_transforms_agree_with_the_poses_that_they_were_made_from(shared_data: Path) -> None:
    """The simulator of this bag publishes each robot's pose, which a broadcaster turns into a transform; rosbags reads it."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    path = shared_data / "logs" / "rosbag" / "example.bag"
    poses: dict[str, list[tuple[float, float, float]]] = {"turtle1": [], "turtle2": []}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS1_NOETIC)) as bag:
        topics = [c for c in bag.connections if c.topic.endswith("/pose")]
        for connection, _, raw in bag.messages(connections=topics):
            m = bag.deserialize(raw, connection.msgtype)
            poses[connection.topic.split("/")[1]].append((m.x, m.y, m.theta))
    for batch in detect(path).read(path, ReadOptions(ReadReport(path))):
        for robot, code in zip(batch.vehicle.names, range(9), strict=False):
            mine = batch.vehicle.codes == code
            read = np.column_stack([batch.columns[n][mine] for n in ("x", "y", "heading")])
            told = np.array(poses.pop(robot))
            told[:, 2] = np.arctan2(np.sin(told[:, 2]), np.cos(told[:, 2]))
            np.testing.assert_allclose(read, told, atol=1e-6)
    assert not poses


def test_ubx_agrees_with_pyubx2(shared_data: Path) -> None:
    pyubx2 = pytest.importorskip("pyubx2")
    path = shared_data / "logs" / "ubx" / "pygpsdata-MIXED.log"
    theirs = []
    with path.open("rb") as stream:
        for _, m in pyubx2.UBXReader(stream, protfilter=2, quitonerror=0):
            if m is not None and m.identity == "NAV-PVT":
                theirs.append((m.lat, m.lon, m.hMSL / 1000, m.gSpeed / 1000))
    read = read_log(path)
    ours = list(zip(*(read.column(c) for c in ("latitude", "longitude", "z", "speed")), strict=True))
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        assert a == pytest.approx(b, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "status"),
    [("gpx/around-visnjan-with-car.gpx", 0), ("nmea/gpsdf.log", 3), ("mcap/talker.mcap", 1), ("rosbag/empty-file.bag", 1),
     ("gpx/track-with-extremes.gpx", 1), ("mcap/locationfix_json.mcap", 0), ("nmea/ais-nmea.log", 0), ("ubx/pygpsdata-NMEA.log", 1)],
)  # fmt: skip
def test_through_the_command(name: str, status: int, shared_data: Path, tmp_path: Path) -> None:
    """As a user does it: the exit status, and one line without a traceback where it is refused."""
    command = [sys.executable, "-c", "from fleetlog.cli.main import entry; entry()", "import", "--json"]
    log = str(shared_data / "logs" / name)
    done = subprocess.run(
        [*command, log, "-o", str(tmp_path / "d")], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    if status == 1:
        assert len([line for line in done.stderr.splitlines() if line.startswith("fleetlog:")]) == 1
        assert not (tmp_path / "d").exists()
    else:
        assert json.loads(done.stdout)
        assert (tmp_path / "d" / "dataset.json").is_file()
