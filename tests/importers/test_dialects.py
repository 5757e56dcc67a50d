"""How devices, databases and recorders write logs: the same rows in another dialect are the same rows."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_reading import read_log

from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import FormatError
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import profile_from_dict
from fleetlog.importers._table_rows import numbers, one_angle
from fleetlog.importers._units import find_unit, from_iso
from fleetlog.importers.base import RawBatch, ReadOptions, detect
from fleetlog.ingest.reading import Order
from fleetlog.ingest.rows import FILE, RECORD

STAMPS = [f"2026-03-02T05:00:{i:02d}Z" for i in range(6)]


def one(path: Path, text: str | bytes, profile: dict[str, Any] | None = None) -> tuple[RawBatch, ReadReport]:
    if text:
        path.write_bytes(text.encode() if isinstance(text, str) else text)
    report = ReadReport(path)
    options = ReadOptions(report, profile_from_dict(profile) if profile else None)
    (batch,) = detect(path).read(path, options)
    return batch, report


def table(header: str, *cells: list[Any]) -> str:
    return "\n".join([header, *(",".join(map(str, row)) for row in zip(*cells, strict=True))]) + "\n"


PLACES = [[49.97 + i * 1e-5 for i in range(6)], [9.15 + i * 1e-5 for i in range(6)]]


def test_columns_never_change_their_meaning_within_a_file(tmp_path: Path) -> None:
    first = table("time,lat,lon", STAMPS[:3], *(p[:3] for p in PLACES))
    batch, _ = one(tmp_path / "a.csv", first + table(" time, lat, lon", STAMPS[3:], *(p[3:] for p in PLACES)))
    assert (len(batch), [r.reason for r in batch.rejects]) == (6, ["the header line again"])
    with pytest.raises(FormatError, match="columns in another order") as error:
        one(tmp_path / "b.csv", first + table("time,lon,lat", STAMPS[3:], *(p[3:] for p in PLACES[::-1])))
    assert "line 5" in error.value.line()


@pytest.mark.parametrize(("north", "east"), [("N", "E"), ("S", "E"), ("N", "W"), ("S", "W")])
def test_hemispheres_behind_the_figures_count(tmp_path: Path, north: str, east: str) -> None:
    cells = [STAMPS, PLACES[0], [north] * 6, PLACES[1], [east] * 6]
    batch, report = one(tmp_path / "a.csv", table("time,lat,N/S,lon,E/W", *cells))
    signs = [np.sign(batch.columns[n]).tolist() for n in ("latitude", "longitude")]
    assert signs == [[1 if north == "N" else -1] * 6, [1 if east == "E" else -1] * 6]
    assert "sign of latitude" in report.recognised["N/S"]
    cells[2] = ["North"] * 6  # no letter, no sign
    assert (one(tmp_path / "b.csv", table("time,lat,N/S,lon,E/W", *cells))[0].columns["latitude"] > 0).all()


@pytest.mark.parametrize(
    ("text", "value"), [("N49.5", 49.5), ("49.5S", -49.5), ("W009.25", -9.25), ("4958.614N", None)]
)
def test_letters_without_blanks(text: str, value: float | None) -> None:
    assert one_angle(text) == value


@given(st.lists(st.floats(-6.28, 6.28), min_size=2, max_size=6))
def test_radians_are_the_same_angle_within_half_a_turn(angles: list[float]) -> None:
    unit = find_unit("rad", "angle")
    assert unit is not None
    out = unit.to_si(np.array(angles))
    assert (np.abs(out) <= math.pi).all()
    assert np.allclose(np.cos(out - np.array(angles)), 1.0)
    within = np.abs(angles) <= math.pi
    assert (out[within] == np.array(angles)[within]).all()


def test_headings_in_degrees_are_kept_and_not_taken_for_radians(tmp_path: Path) -> None:
    text = table("time,lat,lon,Heading", STAMPS, *PLACES, [0, 3, 90, 180, 270, 359])
    batch, report = one(tmp_path / "a.csv", text)
    assert "heading" not in batch.columns
    assert batch.columns["Heading_log"].tolist() == [0, 3, 90, 180, 270, 359]
    assert "degrees" in report.recognised["Heading"]
    said = {"columns": {"heading": {"column": "Heading", "unit": "compass_deg"}}}
    batch, _ = one(tmp_path / "a.csv", text, said)
    assert batch.columns["heading"][2] == pytest.approx(0.0)


def test_the_id_of_a_row_is_no_vehicle(tmp_path: Path) -> None:
    ids = list(range(1000, 1006))
    batch, _ = one(tmp_path / "a.csv", table("id,time,device_id,lat,lon", ids, STAMPS, ["T1"] * 6, *PLACES))
    assert set(batch.vehicle.strings()) == {"T1"}
    batch, report = one(tmp_path / "b.csv", table("id,time,lat,lon", ids, STAMPS, *PLACES))
    assert set(batch.vehicle.strings()) == {"b"}
    assert batch.columns["id"].tolist() == ids
    assert "row's" in report.recognised["id"]
    # Vehicles of which each is seen once, at one moment, stay vehicles; so do those that come again.
    batch, _ = one(tmp_path / "c.csv", table("id,time,lat,lon", ids, [STAMPS[0]] * 6, *PLACES))
    assert len(set(batch.vehicle.strings())) == 6
    batch, _ = one(tmp_path / "d.csv", table("id,time,lat,lon", [1, 2, 3] * 2, STAMPS, *PLACES))
    assert len(set(batch.vehicle.strings())) == 3


@pytest.mark.parametrize("style", ["{}T{},250Z", "{} {},250 UTC", "{} {}.250 GMT", "{} {}.250+00:00"])
def test_one_moment_in_the_forms_of_loggers_and_databases(style: str) -> None:
    time, bare = from_iso(pa.array([style.format("2026-03-02", "05:00:01")]))
    assert (time.tolist(), bare.tolist()) == ([1772427601250000], [False])


def test_a_time_that_says_utc_goes_before_a_local_one(tmp_path: Path) -> None:
    local = [s.replace("T05", " 06").rstrip("Z") for s in STAMPS]
    batch, _ = one(tmp_path / "a.csv", table("datetime,timestamp_utc,lat,lon", local, STAMPS, *PLACES))
    assert batch.time[0] == 1772427600000000


def test_a_commented_line_that_names_the_figures_below_is_their_header(tmp_path: Path) -> None:
    seconds = list(range(1772427600, 1772427606))
    batch, report = one(tmp_path / "a.csv", "# a drive\n" + table("# time,x,y", seconds, [0] * 6, [1] * 6))
    assert (len(batch), batch.columns["y"].tolist()) == (6, [1.0] * 6)
    assert any("header is the comment" in note for note in report.notes)


def test_nul_bytes_fill_and_mean_nothing(tmp_path: Path) -> None:
    text = table("time,lat,lon", STAMPS, *PLACES)
    plain, _ = one(tmp_path / "a.csv", text)
    padded, report = one(tmp_path / "b.csv", text.replace(",", "\0\0,").encode() + b"\0" * 600)
    assert padded.columns["latitude"].tolist() == plain.columns["latitude"].tolist()
    assert not padded.rejects
    assert any("NUL" in note for note in report.notes)


@given(st.floats(-999_999.9, 999_999.9).map(lambda v: round(v, 1)))
def test_thousands_may_be_set_apart(value: float) -> None:
    english = f"{value:,.1f}"
    german = english.translate(str.maketrans(",.", ".,"))
    for text, point in ((english, "."), (german, ",")):
        values, bad = numbers(pa.array([text]), point)
        assert (values.tolist(), bad.tolist()) == ([value], [False])


def test_a_comma_alone_is_not_guessed() -> None:
    assert numbers(pa.array(["1,234"]))[1].tolist() == [True]
    assert numbers(pa.array(["1.234"]))[0].tolist() == [1.234]


@pytest.mark.parametrize("text", ["MPH", "mph", "KM/H", "km/hr", "m/sec", "Meters/second", "knots"])
def test_units_in_any_capitals(text: str) -> None:
    assert find_unit(text, "speed") is not None


def test_xml_behind_blanks_and_with_a_prefix_that_nothing_declares(tmp_path: Path) -> None:
    points = "".join(
        f'<trkpt lat="49.9" lon="9.1"><time>{t}</time><extensions><x:speed>2</x:speed></extensions></trkpt>'
        for t in STAMPS
    )
    path = tmp_path / "a.gpx"
    path.write_text(f'\n  <?xml version="1.0"?><gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>')
    read = read_log(path)
    assert read.rows == 6
    assert read.column("speed").tolist() == [2.0] * 6


MESSAGES = [
    {
        "timestamp": t, "version": "2.0.0", "manufacturer": "M", "serialNumber": "1",
        "agvPosition": {"x": float(i), "y": 0.0, "theta": 0.0, "mapId": "m", "positionInitialized": True},
        "batteryState": {"batteryCharge": 70.0, "charging": False},
    }
    for i, t in enumerate(STAMPS)
]  # fmt: skip


@pytest.mark.parametrize("form", ["lines", "array", "pretty", "one after the other", "enveloped", "message"])
def test_messages_are_the_same_however_they_are_kept(tmp_path: Path, form: str) -> None:
    wrapped = [{"timestamp": 5, "topic": "uagv/v2/M/1/state", "payload": m} for m in MESSAGES]
    named = [{"topic": "uagv/v2/M/1/state", "message": json.dumps(m)} for m in MESSAGES]
    texts = {
        "lines": "\n".join(map(json.dumps, MESSAGES)),
        "array": json.dumps(MESSAGES),
        "pretty": json.dumps(MESSAGES, indent=2),
        "one after the other": "\n".join(json.dumps(m, indent=2) for m in MESSAGES),
        "enveloped": "\n".join(map(json.dumps, wrapped)),
        "message": "\n".join(map(json.dumps, named)),
    }
    path = tmp_path / "log.json"
    path.write_text(texts[form])
    read = read_log(path)
    assert (read.rows, read.channel_rows, read.vehicles, read.status) == (6, 6, {"M/1"}, 0)
    assert read.column("x").tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_a_cut_array_gives_what_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "log.json"
    path.write_text(json.dumps(MESSAGES)[:-30])
    read = read_log(path)
    assert (read.rows, read.status) == (5, 3)


@pytest.mark.parametrize(("encoding", "crs"), [("WKB", None), ("geoarrow", None), ("WKB", "EPSG:25832")])
def test_points_of_geoparquet(tmp_path: Path, encoding: Any, crs: str | None) -> None:
    points = geopandas.points_from_xy(PLACES[1], PLACES[0])
    frame = geopandas.GeoDataFrame({"timestamp": STAMPS}, geometry=points, crs=4326)
    frame = frame.to_crs(crs) if crs else frame
    frame.to_parquet(tmp_path / "a.parquet", geometry_encoding=encoding)
    batch, _ = one(tmp_path / "a.parquet", b"", {"crs": crs} if crs else None)
    names = ("x", "y") if crs else ("longitude", "latitude")
    assert np.allclose(batch.columns[names[0]], frame.geometry.x)
    assert np.allclose(batch.columns[names[1]], frame.geometry.y)


def test_a_log_in_no_order_loses_nothing_and_a_slip_of_the_clock_is_refused() -> None:
    def sift(seconds: np.ndarray) -> int:
        numbers_of = {FILE: np.zeros(len(seconds)), RECORD: np.arange(len(seconds), dtype=np.float64)}
        order = Order()
        kept, _ = order.sift(Trajectory("A", (seconds * 1_000_000).astype(np.int64), numbers_of))
        return len(kept) + sum(len(good) for good, _ in order.flush())

    seconds = np.arange(1000) * 5 + 1_772_427_600
    assert sift(seconds) == 1000
    assert sift(np.random.default_rng(3).permutation(seconds)) == 1000
    slipped = seconds.copy()
    slipped[[200, 500]] -= 3600
    assert sift(slipped) == 998
