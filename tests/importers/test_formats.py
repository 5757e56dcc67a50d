"""Small logs of the text formats and tables, each written by hand from its specification."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from log_reading import read_log

from fleetlog.errors import FleetlogError
from fleetlog.importers.base import detect

STAMP = "2026-03-02T06:00:%02d.500Z"
FIRST = 1_772_431_200_500_000


def state(i: int, version: str) -> dict[str, object]:
    head = {
        "headerId": i,
        "timestamp": STAMP % i,
        "version": version,
        "manufacturer": "KIT",
        "serialNumber": "0007",
    }
    new = version >= "3"
    where = {
        "x": 1.0 * i,
        "y": 2.0,
        "theta": 0.5,
        "mapId": "hall",
        ("localized" if new else "positionInitialized"): i != 9,
    }
    power = {"stateOfCharge" if new else "batteryCharge": 80.0, "batteryVoltage": 48.2, "charging": False}
    return {
        **head, "mobileRobotPosition" if new else "agvPosition": where, "powerSupply" if new else "batteryState": power,
        "velocity": {"vx": 3.0, "vy": 4.0, "omega": 0.0}, "loads": [{"weight": 400.0}, {"weight": 120.0}] if i >= 5 else [],
        "driving": True, "operatingMode": "AUTOMATIC",
    }  # fmt: skip


@pytest.mark.parametrize("version", ["1.1.0", "2.0.0", "2.1.0", "3.0.0"])
@pytest.mark.parametrize("wrap", ["plain", "topic", "envelope", "text"])
def test_vda5050(version: str, wrap: str, tmp_path: Path) -> None:
    lines = []
    for i in range(10):
        text = json.dumps(state(i, version))
        topic = "uagv/v2/KIT/0007/state"
        wrapped = {"topic": f"{topic} {text}", "envelope": json.dumps({"topic": topic, "payload": json.loads(text)}),
                   "text": json.dumps({"topic": topic, "payload": text})}  # fmt: skip
        lines.append(wrapped.get(wrap, text))
    visual = {k: v for k, v in state(7, version).items() if k not in ("loads", "batteryState", "powerSupply")}
    lines.append(json.dumps({**visual, "timestamp": STAMP % 20}))
    lines.append(
        json.dumps(
            {"headerId": 1, "timestamp": STAMP % 21, "serialNumber": "0007", "connectionState": "ONLINE"}
        )
    )
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(lines) + '\n{"headerId": 3, "time')
    assert detect(path).name == "vda5050"
    read = read_log(path)
    assert (read.rows, read.channel_rows, read.vehicles) == (10, 10, {"KIT/0007"})
    assert read.rejects == {
        "the vehicle is not localised": 1,
        "the line is no JSON object, cut off by the end of the file": 1,
    }
    np.testing.assert_allclose(read.column("speed"), 5.0)
    np.testing.assert_allclose(read.column("heading"), 0.5)
    np.testing.assert_allclose(read.column("soc"), 0.8)
    # an empty list is no load, a visualization message does not repeat the load that the state told
    assert read.column("payload").tolist() == [0.0] * 5 + [520.0] * 5
    assert read.column("time")[0] == FIRST
    assert any("1 connection" in n for n in read.report.notes)


def test_vda5050_load_without_weight_is_unknown(tmp_path: Path) -> None:
    message = {**state(1, "2.0.0"), "loads": [{"loadId": "a"}]}
    path = tmp_path / "log.jsonl"
    path.write_text(json.dumps(message) + "\n")
    assert math.isnan(read_log(path).column("payload")[0])


def test_geojson_lines_with_times(tmp_path: Path) -> None:
    times = [STAMP % i for i in range(3)]
    line = [[9.1, 49.9, 100.0], [9.2, 49.9, 101.0], [9.3, 49.9, 102.0]]
    features = [
        {"type": "Feature", "properties": {"vehicle": "A", "coordTimes": times}, "geometry": {"type": "LineString", "coordinates": line}},
        {"type": "Feature", "properties": {"vehicle": "B", "coordinateProperties": {"times": [times, times]}},
         "geometry": {"type": "MultiLineString", "coordinates": [line, line]}},
        {"type": "Feature", "properties": {"times": times[:2]}, "geometry": {"type": "LineString", "coordinates": line}},
    ]  # fmt: skip
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, indent=1))
    read = read_log(path)
    assert (read.rows, read.vehicles) == (9, {"A", "B"})
    assert read.rejects == {"vertex of a line without a time for each": 3}
    assert read.column("longitude")[:3].tolist() == [9.1, 9.2, 9.3]
    assert read.column("time")[0] == FIRST
    text = path.read_text()
    path.write_text(text[: text.rindex("LineString")])
    assert read_log(path).report.damage


def test_geojson_points_in_other_units_and_one_a_line(tmp_path: Path) -> None:
    path = tmp_path / "a.geojsonl"
    path.write_text("\n".join(
        json.dumps({"type": "Feature", "geometry": {"type": "Point", "coordinates": [9.1, 49.9]},
                    "properties": {"truck": "T1", "time": 1_772_431_200_500 + i, "speed_kmh": 36.0, "note": "x"}})
        for i in range(5)))  # fmt: skip
    read = read_log(path)
    assert (read.rows, read.vehicles) == (5, {"T1"})
    np.testing.assert_allclose(read.column("speed"), 10.0)
    assert read.column("time").tolist() == [FIRST + 1000 * i for i in range(5)]


@pytest.mark.parametrize("kind", ["stamp", "naive", "seconds", "milliseconds", "text", "date column"])
def test_parquet_times(kind: str, tmp_path: Path) -> None:
    import pandas as pd

    stamps = pd.date_range("2026-03-02T06:00:00.5", periods=20, freq="s", tz="UTC")
    plain = stamps.tz_localize(None)
    column = {
        "stamp": stamps, "naive": plain, "seconds": (FIRST + np.arange(20) * 1_000_000) / 1e6,
        "milliseconds": FIRST // 1000 + np.arange(20) * 1000, "text": [t.isoformat() for t in stamps], "date column": stamps.tz_convert("Asia/Tokyo"),
    }[kind]  # fmt: skip
    table = pd.DataFrame(
        {"time": column, "lat": 49.9, "lng": 9.1, "truck": ["A", "B"] * 10, "soc_pct": 50.0, "odd": "x"}
    )
    path = tmp_path / "a.parquet"
    table.to_parquet(path)
    read = read_log(path)
    assert (read.rows, read.vehicles, read.status) == (20, {"A", "B"}, 0)
    np.testing.assert_array_equal(read.column("time"), FIRST + np.arange(20) * 1_000_000)
    assert set(read.column("soc")) == {0.5}
    assert set(read.column("odd")) == {"x"}


def test_parquet_names_the_vehicle_by_its_folder(tmp_path: Path) -> None:
    import pandas as pd

    folder = tmp_path / "date=2026-03-02" / "vehicle_id=T%2007"
    folder.mkdir(parents=True)
    pd.DataFrame(
        {"timestamp": pd.date_range("2026-03-02", periods=3, tz="UTC"), "x": 1.0, "y": 2.0}
    ).to_parquet(folder / "part.parquet")
    assert read_log(folder / "part.parquet").vehicles == {"T 07"}


def test_parquet_without_position_names_its_columns(tmp_path: Path) -> None:
    import pandas as pd

    pd.DataFrame({"a": [1.0], "b": [2.0]}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(FleetlogError, match=r"columns: a, b"):
        read_log(tmp_path / "a.parquet")


def test_tum_keeps_microseconds(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_text(
        "# timestamp tx ty tz qx qy qz qw\n1772431200.123457 1 2 3 0 0 0.70710678 0.70710678\n1772431201.5 1 2 3 0 0 0 1\nbad line\n"
    )
    read = read_log(path)
    assert read.column("time").tolist() == [1_772_431_200_123_457, 1_772_431_201_500_000]
    np.testing.assert_allclose(read.column("heading"), [math.pi / 2, 0.0], atol=1e-6)
    assert (read.rows, read.status) == (2, 3)


def sentence(body: str) -> str:
    check = 0
    for c in body.encode():
        check ^= c
    return f"${body}*{check:02X}\r\n"


def gga(clock: str, minute: str = "00.0000") -> str:
    return sentence(f"GPGGA,{clock},49{minute},N,00906.0000,E,1,08,0.9,100.0,M,47.0,M,,")


def test_nmea_sentences_that_everybody_quotes(tmp_path: Path) -> None:
    """GGA and RMC of one moment; values by hand: 48 degrees 7.038', 22.4 knots, course 84.4."""
    path = tmp_path / "a.nmea"
    path.write_text(
        "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,TSTR*46\r\n"
        "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n"
        "$GPRMC,123520,V,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*77\r\n"
    )
    read = read_log(path)
    values = {name: read.column(name).tolist() for name in read.columns}
    assert values.pop("time") == [np.datetime64("1994-03-23T12:35:19", "us").astype(np.int64)]
    assert {name: value for name, (value,) in values.items()} == pytest.approx(
        {"latitude": 48.1173, "longitude": 11.0 + 31.0 / 60.0, "z": 545.4, "gps_quality": 1.0, "satellites": 8.0,
         "hdop": 0.9, "speed": 11.5235556, "heading": math.radians(5.6)}, rel=1e-8
    )  # fmt: skip
    assert "1 moment without a fix left out" in read.report.notes and not read.rejects


def test_nmea_date_from_zda_and_motion_from_vtg(tmp_path: Path) -> None:
    """West and south are negative; a course of 360 degrees is north."""
    path = tmp_path / "a.nmea"
    path.write_text(
        "$GPZDA,201530.00,04,07,2002,00,00*60\r\n$GPGLL,4916.45,N,12311.12,W,225444,A*31\r\n"
        "$GPVTG,054.7,T,034.4,M,005.5,N,010.2,K*48\r\n"
        "$GPRMC,081836,A,3751.65,S,14507.36,E,000.0,360.0,130998,011.3,E*62\r\n"
    )
    read = read_log(path)
    times = np.array(["2002-07-04T22:54:44", "1998-09-13T08:18:36"], "datetime64[us]")
    np.testing.assert_array_equal(read.column("time"), times.astype(np.int64))
    np.testing.assert_allclose(
        read.column("latitude"), [49.0 + 16.45 / 60.0, -37.0 - 51.65 / 60.0], atol=1e-9
    )
    np.testing.assert_allclose(
        read.column("longitude"), [-123.0 - 11.12 / 60.0, 145.0 + 7.36 / 60.0], atol=1e-9
    )
    np.testing.assert_allclose(read.column("speed"), [5.5 * 1852.0 / 3600.0, 0.0])
    np.testing.assert_allclose(read.column("heading"), [math.radians(35.3), math.pi / 2])


@pytest.mark.parametrize(
    ("cells", "reason"),
    [("06050,A,4807.038,N,01131.000,E", "time cannot be read: 06050"), ("060500,A,4867.038,N,01131.000,E", "lat cannot be"),
     ("060500,A,4807.038,X,01131.000,E", "position is not whole"), ("060500,A,4807.038,N,,", "position is not whole"),
     ("060500,A,4807.038,N,-1131.000,E", "lon cannot be read: -1131.000"), ("060500", "too few fields")],
)  # fmt: skip
def test_nmea_damage_under_a_right_checksum(cells: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "a.nmea"
    good = "RMC,060459,A,4807.038,N,01131.000,E,1.0,0.0,020326,,,A"
    path.write_text(sentence(f"GP{good}") + sentence(f"GPRMC,{cells},1.0,0.0,020326"))
    read = read_log(path)
    assert read.rows == 1
    assert [why for why in read.rejects if reason in why] and sum(read.rejects.values()) == 1


def test_nmea_past_midnight_and_dates_in_hindsight(tmp_path: Path) -> None:
    path = tmp_path / "a.nmea"
    rmc = sentence("GNRMC,235959.00,A,4900.0000,N,00906.0000,E,10.0,90.0,310126,,,A")
    path.write_text(
        gga("235957.00") + gga("235958.00") + gga("235959.00") + rmc + gga("000000.00") + gga("000001.00")
    )
    read = read_log(path)
    midnight = np.datetime64("2026-02-01", "us").astype(np.int64)
    np.testing.assert_array_equal(read.column("time"), midnight + np.arange(-3, 2) * 1_000_000)
    assert np.nanmax(read.column("speed")) == pytest.approx(10 * 1852 / 3600)
    assert np.nanmax(np.abs(read.column("heading"))) == pytest.approx(0.0, abs=1e-12)  # 90 degrees is east


def test_nmea_talkers_of_one_moment_are_one_fix(tmp_path: Path) -> None:
    path = tmp_path / "a.nmea"
    rmc = "RMC,060000.00,A,4900.0000,N,00906.0000,E,1.0,0.0,020326,,,A"
    path.write_text(sentence("GP" + rmc) + sentence("GL" + rmc) + sentence("GN" + rmc) + gga("060000.00"))
    assert read_log(path).rows == 1


def test_nmea_without_a_date_says_what_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "a.nmea"
    path.write_text(gga("060000.00") + gga("060001.00"))
    with pytest.raises(FleetlogError, match="2 positions with a time of day but no date"):
        read_log(path)


def test_nmea_with_only_ships(tmp_path: Path) -> None:
    path = tmp_path / "a.nmea"
    path.write_text("!AIVDM,1,1,,A,13HOI:0P0000VOHLCnHQKwvL05Ip,0*23\r\n" * 3)
    with pytest.raises(FleetlogError, match="only AIS: 3 messages"):
        read_log(path, __import__("fleetlog.importers.nmea", fromlist=["IMPORTER"]).IMPORTER)
