"""OSI, CARLA and MF4: files of other people's writers where there are any, else bytes after the published layout."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from fleetlog.errors import FormatError
from fleetlog.importers._open import ReadReport
from fleetlog.importers.base import RawBatch, ReadOptions, detect

START = 1_772_427_600


def read(path: Path) -> tuple[list[RawBatch], ReadReport]:
    report = ReadReport(path)
    return list(detect(path).read(path, ReadOptions(report))), report


def by_vehicle(batches: list[RawBatch], column: str) -> dict[str, list[float]]:
    out: dict[str, list[float]] = {}
    for b in batches:
        for name, value in zip(b.vehicle.strings(), b.columns.get(column, []), strict=False):
            out.setdefault(str(name), []).append(float(value))
    return out


# ------------------------------------------------------------------------------------ OSI


def ground_truth(i: int, kind=None):
    """Two trucks and a pedestrian at second ``i``."""
    from osi3.osi_groundtruth_pb2 import GroundTruth

    said = GroundTruth()
    said.version.version_major = 3
    said.timestamp.seconds, said.timestamp.nanos = START + i, 250_000_000
    for number, what in ((7, 2), (8, 2), (9, 3)):
        o = said.moving_object.add()
        o.id.value, o.type = number, what
        o.base.position.x, o.base.position.y, o.base.position.z = 0.5 * i, float(number), 0.75
        o.base.orientation.yaw = 3.5
        o.base.velocity.x, o.base.velocity.y = 3.0, 4.0
    return said


def sensor_view(i: int):
    from osi3.osi_sensorview_pb2 import SensorView

    said = SensorView()
    said.version.version_major = 3
    said.timestamp.CopyFrom(ground_truth(i).timestamp)
    said.global_ground_truth.CopyFrom(ground_truth(i))
    return said


def traffic_update(i: int):
    from osi3.osi_trafficupdate_pb2 import TrafficUpdate

    said = TrafficUpdate()
    said.version.version_major = 3
    said.timestamp.CopyFrom(ground_truth(i).timestamp)
    said.update.extend(ground_truth(i).moving_object)
    return said


KINDS = {"gt": ground_truth, "sv": sensor_view, "tu": traffic_update}


def check_osi(batches: list[RawBatch], count: int) -> None:
    x = by_vehicle(batches, "x")
    assert x == {"7": [0.5 * i for i in range(count)], "8": [0.5 * i for i in range(count)]}
    assert by_vehicle(batches, "y")["8"] == [8.0] * count
    np.testing.assert_allclose(by_vehicle(batches, "heading")["7"], 3.5 - 2 * np.pi)
    np.testing.assert_allclose(by_vehicle(batches, "speed")["7"], 5.0)
    assert {int(t) % 1_000_000 for b in batches for t in b.time} == {250_000}


@pytest.mark.parametrize("name", ["20260302T050000Z_gt_380_600_5_a.osi", "gt.osi", "trace.osi"])
@pytest.mark.parametrize("kind", KINDS)
def test_osi_traces_of_the_standards_own_writer(tmp_path: Path, kind: str, name: str) -> None:
    pytest.importorskip("osi3", reason="the extra osi is not installed")
    utilities = pytest.importorskip("osi_utilities", reason="the wheel asam-osi-utilities is not installed")
    path = tmp_path / name.replace("gt", kind)
    with utilities.SingleTraceWriter() as writer:
        assert writer.open(path)
        for i in range(5):
            writer.write_message(KINDS[kind](i))
    batches, report = read(path)
    check_osi(batches, 5)
    assert not report.damage


@pytest.mark.parametrize("kind", KINDS)
def test_osi_in_mcap(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("osi3", reason="the extra osi is not installed")
    from mcap_protobuf.writer import Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as stream, Writer(stream) as writer:
        for i in range(5):
            writer.write_message("/truth", KINDS[kind](i), (START + i) * 10**9)
    check_osi(read(path)[0], 5)


def test_an_osi_trace_that_is_cut_off_gives_what_is_whole(tmp_path: Path) -> None:
    pytest.importorskip("osi3", reason="the extra osi is not installed")
    data = b"".join(
        struct.pack("<I", len(d)) + d for i in range(5) for d in [ground_truth(i).SerializeToString()]
    )
    path = tmp_path / "a_gt_.osi"
    path.write_bytes(data[:-3])
    batches, report = read(path)
    check_osi(batches, 4)
    assert report.damage == ["the file breaks off or is wrong after 4 records"]


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    osi, mf4 = tmp_path / "a.osi", tmp_path / "a.mf4"
    osi.write_bytes(struct.pack("<I", 4) + b"\x0a\x02\x08\x03")
    mf4.write_bytes(b"MDF     4.10")
    for module in (
        "osi3",
        "osi3.osi_groundtruth_pb2",
        "osi3.osi_sensorview_pb2",
        "osi3.osi_trafficupdate_pb2",
        "asammdf",
    ):
        monkeypatch.setitem(sys.modules, module, None)
    for path, extra in ((osi, "osi"), (mf4, "mf4")):
        with pytest.raises(FormatError, match=rf"fleetlog\[{extra}\]"):
            read(path)


# ------------------------------------------------------------------------------------ CARLA


def text(value: str) -> bytes:
    return struct.pack("<H", len(value)) + value.encode()


def packet(kind: int, data: bytes) -> bytes:
    return struct.pack("<BI", kind, len(data)) + data


def added(actor: int, kind: int, name: str) -> bytes:
    attributes = struct.pack("<H", 1) + b"\x03" + text("role_name") + text("hero")
    return struct.pack("<IB6fI", actor, kind, *[0.0] * 6, 99) + text(name) + attributes


def carla_log(frames: int = 4) -> bytes:
    """A log as CarlaRecorder.cpp of CARLA 0.9.15 writes it: info, then for each frame its start, events, positions, end."""
    out = struct.pack("<H", 1) + text("CARLA_RECORDER") + struct.pack("<q", START) + text("Town03")
    for i in range(frames):
        out += packet(0, struct.pack("<Qdd", i + 1, 0.05, 0.05 * i))
        if i == 0:
            actors = [added(27, 1, "vehicle.tesla.model3"), added(28, 2, "walker.pedestrian.0001")]
            out += packet(2, struct.pack("<H", len(actors)) + b"".join(actors))
        places = [struct.pack("<I6f", actor, 100.0 * i, 200.0, 10.0, 0.0, 0.0, 90.0) for actor in (27, 28)]
        out += packet(6, struct.pack("<H", 2) + b"".join(places)) + packet(18, b"later") + packet(1, b"")
    return out


def test_carla_positions_are_metres_with_y_to_the_left(tmp_path: Path) -> None:
    path = tmp_path / "recording.log"
    path.write_bytes(carla_log())
    batches, report = read(path)
    assert by_vehicle(batches, "x") == {"tesla.model3-27": [0.0, 1.0, 2.0, 3.0]}
    np.testing.assert_allclose(by_vehicle(batches, "y")["tesla.model3-27"], -2.0)
    np.testing.assert_allclose(by_vehicle(batches, "heading")["tesla.model3-27"], -np.pi / 2)
    assert batches[0].time.tolist() == [START * 1_000_000 + 50_000 * i for i in range(4)]
    assert report.notes == ["recorded by CARLA on the map Town03"]


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_carla_log_that_is_cut_off_gives_what_is_whole(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "recording.log"
    path.write_bytes(carla_log()[:-cut])
    batches, report = read(path)
    assert sum(len(b) for b in batches) in (3, 4)
    assert ("breaks off" in "".join(report.damage)) == (cut not in (5, 15))


# ------------------------------------------------------------------------------------ MF4


def measurement(path: Path, seconds: float = 10.0) -> None:
    """As asammdf writes one: positions at 5 Hz, the battery at 1 Hz, a group of text."""
    mdf = pytest.importorskip("asammdf", reason="the extra mf4 is not installed")
    from datetime import UTC, datetime

    fast, slow = np.arange(0.0, seconds, 0.2), np.arange(0.0, seconds, 1.0)
    with mdf.MDF(version="4.10") as out:
        out.start_time = datetime.fromtimestamp(START, UTC)
        signal = lambda values, at, name, unit: mdf.Signal(values, at, name=name, unit=unit)
        out.append([signal(49.97 + 1e-6 * fast, fast, "GPS_Latitude", "deg"), signal(9.15 + 0 * fast, fast, "GPS_Longitude", "deg"),
                    signal(36.0 + 0 * fast, fast, "VehicleSpeed", "km/h"), signal(fast, fast, "MastTilt", "mrad")])  # fmt: skip
        out.append([signal(80.0 - slow, slow, "SOC", "%"), signal(48.0 + 0 * slow, slow, "Voltage", "V")])
        out.append([mdf.Signal(np.array([b"ok"] * len(slow)), slow, name="State", encoding="utf-8")])
        out.save(path, overwrite=True)


def test_mf4_channels_are_known_by_name_and_unit(tmp_path: Path) -> None:
    path = tmp_path / "truck7.mf4"
    measurement(path)
    batches, report = read(path)
    placed, battery = batches
    assert placed.has_position and len(placed) == 50 and placed.vehicle.names == ("truck7",)
    assert placed.time.tolist()[:3] == [START * 1_000_000 + 200_000 * i for i in range(3)]
    np.testing.assert_allclose(placed.columns["latitude"], 49.97 + 2e-7 * np.arange(50), atol=1e-12)
    np.testing.assert_allclose(placed.columns["speed"], 10.0)
    assert "MastTilt [mrad]" in placed.columns
    assert not battery.has_position
    np.testing.assert_allclose(battery.columns["soc"], 0.80 - 0.01 * np.arange(10))
    assert report.recognised["SOC [%]"] == "soc, from %"


def test_mf4_without_a_position_says_what_it_holds(tmp_path: Path) -> None:
    mdf = pytest.importorskip("asammdf", reason="the extra mf4 is not installed")
    with mdf.MDF() as out:
        out.append([mdf.Signal(np.arange(3.0), np.arange(3.0), name="Voltage", unit="V")])
        out.save(tmp_path / "a.mf4")
    with pytest.raises(FormatError, match=r"Voltage \[V\]"):
        read(tmp_path / "a.mf4")
