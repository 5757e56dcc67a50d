"""TCX, KML, FIT and KITTI: small files written by hand after their specifications."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from fleetlog.errors import FormatError
from fleetlog.importers._open import ReadReport
from fleetlog.importers.base import ReadOptions, detect

TCX = """<TrainingCenterDatabase xmlns="http://www.garmin.com/xmlschemas/TrainingCenterDatabase/v2"><Activities><Activity><Lap><Track>
<Trackpoint><Time>2026-03-02T05:00:00Z</Time><Position><LatitudeDegrees>49.97</LatitudeDegrees><LongitudeDegrees>9.15</LongitudeDegrees>
</Position><AltitudeMeters>120</AltitudeMeters><Extensions><TPX><Speed>1.5</Speed></TPX></Extensions></Trackpoint>
<Trackpoint><Time>2026-03-02T05:00:01Z</Time></Trackpoint>
<Trackpoint><Time>soon</Time><Position><LatitudeDegrees>49.97</LatitudeDegrees><LongitudeDegrees>9.15</LongitudeDegrees></Position></Trackpoint>
</Track></Lap></Activity></Activities></TrainingCenterDatabase>"""
KML = """<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Placemark><gx:Track>
<when>2026-03-02T05:00:00Z</when><when>2026-03-02T05:00:02Z</when>
<gx:coord>9.15 49.97 120</gx:coord><gx:coord>9.16 49.98 121</gx:coord></gx:Track></Placemark>
<Placemark><LineString><coordinates>9,49 10,50</coordinates></LineString></Placemark></kml>"""


def rows(path):
    report = ReadReport(path, detect(path).name)
    batches = list(detect(path).read(path, ReadOptions(report)))
    return batches[0], [r for b in batches for r in b.rejects], report


def test_tcx_gives_points_with_a_position_and_rejects_one_without_a_time(tmp_path):
    path = tmp_path / "a.tcx"
    path.write_text(TCX)
    batch, rejects, report = rows(path)
    assert len(batch) == 1
    assert batch.columns["speed"][0] == 1.5 and batch.columns["z"][0] == 120.0
    assert [r.reason for r in rejects] == ["time is not ISO 8601"]
    assert any("without a position" in note for note in report.notes)


def test_kml_gives_a_track_and_says_what_it_leaves_out(tmp_path):
    path = tmp_path / "a.kml"
    path.write_text(KML)
    batch, rejects, report = rows(path)
    assert np.diff(batch.time).tolist() == [2_000_000]
    assert batch.columns["latitude"].tolist() == [49.97, 49.98]
    assert not rejects
    assert any("line without times" in note or "without times" in note for note in report.notes)


def fit(count: int) -> bytes:
    """A file of record messages (FIT protocol 2.0): definition of message 20 with time, position and altitude."""
    fields = [(253, 4, 0x86), (0, 4, 0x85), (1, 4, 0x85), (2, 2, 0x84)]
    body = struct.pack("<BBBHB", 0x40, 0, 0, 20, len(fields)) + b"".join(bytes(f) for f in fields)
    for i in range(count):
        latitude, longitude = (round(v * 2**31 / 180.0) for v in (49.97 + i * 1e-4, 9.15))
        body += struct.pack("<BIiiH", 0, 1_000_000_000 + i, latitude, longitude, (120 + 500) * 5)
    head = struct.pack("<BBHI4s", 14, 0x20, 2100, len(body), b".FIT")
    head += struct.pack("<H", crc(head))
    return head + body + struct.pack("<H", crc(head + body))


def crc(data: bytes) -> int:
    table = [0x0000, 0xCC01, 0xD801, 0x1400, 0xF001, 0x3C00, 0x2800, 0xE401,
             0xA001, 0x6C00, 0x7800, 0xB401, 0x5000, 0x9C01, 0x8801, 0x4400]  # fmt: skip
    value = 0
    for byte in data:
        for part in (byte & 15, byte >> 4):
            value = ((value >> 4) & 0x0FFF) ^ table[value & 15] ^ table[part]
    return value


def test_fit_records_come_in_degrees_metres_and_utc(tmp_path):
    pytest.importorskip("fitdecode")
    path = tmp_path / "a.fit"
    path.write_bytes(fit(5))
    batch, rejects, _ = rows(path)
    assert not rejects
    np.testing.assert_allclose(batch.columns["latitude"], 49.97 + np.arange(5) * 1e-4, atol=1e-7)
    assert batch.columns["z"].tolist() == [120.0] * 5
    # FIT counts seconds from 1989-12-31T00:00:00Z
    assert (
        batch.time[0] == int(np.datetime64("1989-12-31T00:00:00", "us").astype(int)) + 1_000_000_000_000_000
    )


def test_a_fit_file_that_breaks_off_gives_what_is_whole(tmp_path):
    pytest.importorskip("fitdecode")
    path = tmp_path / "a.fit"
    path.write_bytes(fit(50)[:-200])
    batch, _, report = rows(path)
    assert 20 < len(batch) < 50
    assert report.damage


def test_kitti_poses_need_their_times_and_keep_the_heading(tmp_path):
    path = tmp_path / "07.txt"
    pose = lambda x, yaw: f"{np.cos(yaw)} {-np.sin(yaw)} 0 {x} {np.sin(yaw)} {np.cos(yaw)} 0 2 0 0 1 0.5\n"
    path.write_text(pose(0.0, 0.0) + pose(1.0, 0.5))
    with pytest.raises(FormatError, match=r"times\.txt"):
        rows(path)
    (tmp_path / "times.txt").write_text("1772427600.0\n1772427600.5\n")
    batch, _, _ = rows(path)
    assert batch.columns["x"].tolist() == [0.0, 1.0]
    np.testing.assert_allclose(batch.columns["heading"], [0.0, 0.5], atol=1e-12)
    assert np.diff(batch.time).tolist() == [500_000]
