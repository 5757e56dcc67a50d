"""Whatever is done to a file: rows or one FleetlogError, soon, and no memory beyond reason."""

from __future__ import annotations

import gzip
import io
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from log_reading import read_log

from fleetlog.errors import FleetlogError
from fleetlog.importers import geojson, gpx, nmea, parquet, sumo_fcd, tum, vda5050
from fleetlog.importers.base import by_name

SEEDS: dict[str, bytes] = {
    "gpx": b'<?xml version="1.0"?><gpx version="1.1"><trk><name>a</name><trkseg>'
    + b"".join(b'<trkpt lat="49.9" lon="9.%03d"><ele>1</ele><time>2026-03-02T06:00:%02dZ</time></trkpt>' % (i, i) for i in range(30))
    + b"</trkseg></trk></gpx>",
    "tum": b"".join(b"17000000%02d.5 %d 2 3 0 0 0 1\n" % (i, i) for i in range(30)),
    "sumo-fcd": b"<fcd-export>" + b"".join(b'<timestep time="%d"><vehicle id="v" x="1.0" y="2.0" angle="3"/></timestep>' % i for i in range(30))
    + b"</fcd-export>",
    "geojson": b'{"type": "FeatureCollection", "features": [' + b",".join(
        b'{"type": "Feature", "geometry": {"type": "Point", "coordinates": [9.1, 49.9]}, "properties": {"time": "2026-03-02T06:00:%02dZ"}}' % i
        for i in range(30)) + b"]}",
    "vda5050": b"".join(
        b'{"headerId": 1, "timestamp": "2026-03-02T06:00:%02dZ", "serialNumber": "7", "agvPosition": {"x": 1, "y": 2, "theta": 0}}\n' % i
        for i in range(30)),
    "nmea": b"$GPRMC,103607.00,A,5327.03942,N,00214.42462,W,0.046,,060321,,,A,V*26\r\n" * 3 + b"\xb5b\x01\x07\x5c\x00" + bytes(92) + b"\x00\x00",
}  # fmt: skip
REAL = {
    "gpx": "logs/gpx/gpx1.1_with_all_fields.gpx", "nmea": "logs/ubx/pygpsdata-MIXED.log", "mcap": "logs/mcap/locationfix_json.mcap",
    "rosbag": "logs/rosbag/talker.db3",
}  # fmt: skip
BUDGET = 10.0


def survive(name: str, data: bytes, folder: Path) -> None:
    path = folder / f"x.{'db3' if data.startswith(b'SQLite') else 'bin'}"
    path.write_bytes(data)
    begin = time.process_time()
    try:
        read_log(path, by_name(name))
    except FleetlogError as error:
        assert "\n" not in error.line()
    assert time.process_time() - begin < BUDGET


damage = st.tuples(
    st.floats(0.0, 1.0),
    st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=6),
    st.binary(max_size=12),
)


def apply(data: bytes, change: tuple[float, list[tuple[float, int]], bytes]) -> bytes:
    share, flips, extra = change
    out = bytearray(data[: max(int(len(data) * (0.05 + share)), 1)])
    for place, value in flips:
        out[min(int(place * len(out)), len(out) - 1)] = value
    at = int(share * len(out))
    return bytes(out[:at] + extra + out[at:])


@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(change=damage)
def test_damage_gives_rows_or_one_line(name: str, change, tmp_path_factory) -> None:
    survive(name, apply(SEEDS[name], change), tmp_path_factory.getbasetemp())


@pytest.mark.parametrize("name", REAL)
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(change=damage)
def test_damage_to_real_files(name: str, change, tmp_path_factory, shared_data: Path) -> None:
    survive(name, apply((shared_data / REAL[name]).read_bytes(), change), tmp_path_factory.getbasetemp())


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(change=damage, name=st.sampled_from(["mcap", "parquet", "rosbag"]))
def test_damage_to_recordings(change, name: str, tmp_path_factory) -> None:
    survive(
        name, apply(_recording(name, tmp_path_factory.getbasetemp()), change), tmp_path_factory.getbasetemp()
    )


_MADE: dict[str, bytes] = {}


def _recording(name: str, folder: Path) -> bytes:
    if name in _MADE:
        return _MADE[name]
    path = folder / f"seed-{name}"
    if name == "parquet":
        import pandas as pd

        stamps = pd.date_range("2026-03-02", periods=50, freq="s", tz="UTC")
        pd.DataFrame({"time": stamps, "lat": 49.9, "lon": 9.1, "id": "T1"}).to_parquet(path)
    elif name == "mcap":
        from mcap.writer import CompressionType
        from test_recordings import big_json

        big_json(path, CompressionType.LZ4, 300)
    else:
        from test_recordings import write_rosbag

        write_rosbag(path, 1)
    _MADE[name] = path.read_bytes()
    return _MADE[name]


def test_entities_are_not_expanded(tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("2026-03-02T06:00:00Z")
    laughs = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 20 if i else "ha"}">' for i in range(12))
    for doctype in (laughs, f'<!ENTITY a11 SYSTEM "{secret.as_uri()}">'):
        path = tmp_path / "x.gpx"
        path.write_text(
            f'<?xml version="1.0"?><!DOCTYPE gpx [{doctype}]><gpx><trk><trkseg><trkpt lat="1" lon="2"><time>&a11;</time></trkpt>'
            "</trkseg></trk></gpx>"
        )
        begin = time.process_time()
        with pytest.raises(FleetlogError):
            read_log(path, gpx.IMPORTER)
        assert time.process_time() - begin < 2.0


def test_a_packed_bomb_is_refused(tmp_path: Path) -> None:
    """105 MB of XML inside one element, half a megabyte packed: refused after 16 MB."""
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb", compresslevel=1) as out:
        out.write(b"<gpx><trk><trkseg><trkpt lat='1' lon='2'>")
        for _ in range(200):
            out.write(b"<a></a>" * 75_000)
    path = tmp_path / "x.gpx.gz"
    path.write_bytes(packed.getvalue())
    with pytest.raises(FleetlogError):
        read_log(path, gpx.IMPORTER)


def test_deep_nesting_is_one_rejected_line(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    path.write_bytes(SEEDS["vda5050"] + b'{"a":' * 100_000 + b"\n")
    read = read_log(path, vda5050.IMPORTER)
    assert (read.rows, sum(read.rejects.values())) == (30, 1)
    path.write_bytes(b'{"type": "Feature", "a": ' + b"[" * 100_000)
    with pytest.raises(FleetlogError):
        read_log(path, geojson.IMPORTER)


@pytest.mark.parametrize("importer", [geojson, gpx, nmea, parquet, sumo_fcd, tum, vda5050])
def test_empty_and_nonsense(importer, tmp_path: Path) -> None:
    for data in (b"", b"\x00" * 5000, b"hello\n", bytes(range(256)) * 40):
        path = tmp_path / "x"
        path.write_bytes(data)
        with pytest.raises(FleetlogError):
            read_log(path, importer.IMPORTER)


@pytest.mark.parametrize("name", ["mcap", "parquet", "rosbag"])
def test_recordings_packed_as_a_whole_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "x.gz"
    path.write_bytes(gzip.compress(_recording(name, tmp_path)))
    with pytest.raises(FleetlogError, match="the whole file is packed with gzip"):
        read_log(path, by_name(name))
