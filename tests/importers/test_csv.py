"""Delimited text: what is read, what is recognised, what is refused, and that every line is one or the other."""

from __future__ import annotations

import codecs
import csv
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.trajectory import Labels
from fleetlog.errors import FormatError, InputError
from fleetlog.importers import _csv_table
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Profile, profile_from_dict
from fleetlog.importers._table_rows import one_angle
from fleetlog.importers._units import UNITS, find_unit, recognise
from fleetlog.importers.base import RawBatch, ReadOptions, detect

HEADER = "vehicle_id,timestamp,x,y,speed\n"


def read(path: Path, profile: Profile | None = None) -> tuple[list[RawBatch], ReadReport]:
    report = ReadReport(path)
    return list(detect(path).read(path, ReadOptions(report, profile))), report


def one(path: Path, text: str | bytes, profile: dict[str, Any] | None = None) -> tuple[RawBatch, ReadReport]:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    batches, report = read(path, profile_from_dict(profile) if profile else None)
    assert len(batches) == 1
    return batches[0], report


def rows(count: int, start: int = 0) -> str:
    return "".join(
        f"A,2026-03-02T05:{i // 60:02d}:{i % 60:02d}Z,{i}.5,{-i},1.25\n" for i in range(start, start + count)
    )


def test_contract_names_need_no_word(tmp_path: Path) -> None:
    batch, report = one(tmp_path / "a.csv", HEADER + rows(3))
    assert batch.vehicle.strings() == ["A"] * 3
    assert batch.time.tolist() == [1772427600000000 + i * 1_000_000 for i in range(3)]
    assert batch.columns["x"].tolist() == [0.5, 1.5, 2.5]
    assert batch.record.tolist() == [2, 3, 4]
    assert not (report.recognised or report.notes or report.damage or batch.rejects)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_encodings_and_delimiters_give_the_same(tmp_path: Path, encoding: str, delimiter: str) -> None:
    text = (HEADER + rows(4)).replace(",", delimiter).replace("A" + delimiter, "Käfer" + delimiter)
    batch, _ = one(tmp_path / "a.csv", text.encode(encoding))
    assert batch.vehicle.strings() == ["Käfer"] * 4
    assert batch.columns["speed"].tolist() == [1.25] * 4


def test_decimal_comma(tmp_path: Path) -> None:
    text = "vehicle_id;timestamp;x;y\nA;2026-03-02T05:00:00Z;1,5;-2,25\n"
    batch, _ = one(tmp_path / "a.csv", text, {"decimal": ","})
    assert [batch.columns[n][0] for n in "xy"] == [1.5, -2.25]


@pytest.mark.parametrize("pack", ["gz", "zst"])
def test_packed_and_cut_off(tmp_path: Path, pack: str) -> None:
    text = (HEADER + rows(3000)).encode()
    if pack == "gz":
        packed = gzip.compress(text)
    else:
        import zstandard

        packed = zstandard.ZstdCompressor().compress(text)
    path = tmp_path / f"a.csv.{pack}"
    path.write_bytes(packed)
    batches, report = read(path)
    assert sum(map(len, batches)) == 3000 and not report.damage
    path.write_bytes(packed + packed)  # streams that follow one another are one file
    batches, report = read(path)
    assert sum(map(len, batches)) == 6000 and not report.damage
    path.write_bytes(packed[: -len(packed) // 8])
    try:
        batches, report = read(path)
    except FormatError:
        assert pack == "zst"  # a small zstd file is one block: nothing of it is whole
        return
    assert 500 < sum(map(len, batches)) < 3000
    assert any("cut off" in d for d in report.damage)


def test_ragged_rows_are_refused_never_shifted(tmp_path: Path) -> None:
    text = (
        HEADER
        + "A,2026-03-02T05:00:00Z,1,2,3\n\nA,2026-03-02T05:00:01Z,1,2,3,4\nA,2026-03-02T05:00:02Z,1\n"
        + rows(1, 3)
    )
    batch, report = one(tmp_path / "a.csv", text)
    assert batch.record.tolist() == [2, 6]
    assert [(r.record, r.reason) for r in batch.rejects] == [
        (4, "the line has more fields than the header"), (5, "the line has fewer fields than the header"),
    ]  # fmt: skip
    assert batch.rejects[0].text == "A,2026-03-02T05:00:01Z,1,2,3,4"
    assert not report.damage


def test_last_line_cut_off_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(HEADER + rows(5) + "A,2026-03-0")
    batches, report = read(path)
    assert sum(map(len, batches)) == 5
    assert [(r.record, r.reason) for b in batches for r in b.rejects] == [(7, "the line is cut off")]
    assert report.damage and "7" in report.damage[0]


def test_header_again_in_the_middle(tmp_path: Path) -> None:
    batch, _ = one(tmp_path / "a.csv", HEADER + rows(2) + HEADER + rows(2, 2))
    assert len(batch) == 4
    assert [(r.record, r.reason) for r in batch.rejects] == [(4, "the header line again")]


def test_bad_cells(tmp_path: Path) -> None:
    lines = ["A,2026-03-02T05:00:00Z,1,2,fast", "A,2026-03-02T05:00:01Z,here,2,3", "A,yesterday,1,2,3", ",2026-03-02T05:00:03Z,1,2,3",
             "A,,1,2,3", "A,2026-03-02T05:00:05Z,inf,2,3", "A,2026-03-02T05:00:06Z,1,2,", "A,2026-03-02T05:00:07Z, 4 ,+2,nan"]  # fmt: skip
    batch, _ = one(tmp_path / "a.csv", HEADER + rows(3, 30) + "\n".join(lines) + "\n")
    assert batch.record.tolist() == [2, 3, 4, 5, 11, 12]
    assert np.isnan(batch.columns["speed"][3:]).all()
    assert [(r.record, r.reason, r.whole) for r in batch.rejects] == [
        (5, "speed is not a number", False), (6, "x is not a number", True), (7, "the time cannot be read", True),
        (8, "the vehicle id is missing", True), (9, "the time is missing", True), (10, "x is not a number", True),
    ]  # fmt: skip


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.sampled_from(["good", "more", "fewer", "time", "text", "header", "blank", "quote"]),
        min_size=1,
        max_size=40,
    )
)
def test_every_line_is_a_row_or_refused(tmp_path_factory: pytest.TempPathFactory, kinds: list[str]) -> None:
    make = {
        "good": "A,2026-03-02T05:00:00Z,1,2,3", "more": "A,2026-03-02T05:00:00Z,1,2,3,4", "fewer": "A,2026-03-02T05:00:00Z,1",
        "time": "A,soon,1,2,3", "text": "A,2026-03-02T05:00:00Z,east,2,3", "header": HEADER.strip(), "blank": "",
        "quote": '"A","2026-03-02T05:00:00Z","1",2,3',
    }  # fmt: skip
    usual = 41  # most rows have as many fields as the header
    text = HEADER + (make["good"] + "\n") * usual + "".join(make[k] + "\n" for k in kinds)
    batch, _ = one(tmp_path_factory.mktemp("x") / "a.csv", text)
    expected = [2 + usual + i for i, k in enumerate(kinds) if k != "blank"]
    refused = [r.record for r in batch.rejects]
    assert sorted([*batch.record.tolist(), *refused]) == [*range(2, 2 + usual), *expected]
    assert refused == [2 + usual + i for i, k in enumerate(kinds) if k not in ("blank", "good", "quote")]


@pytest.mark.parametrize("size", [80, 300, 1000])
def test_blocks_change_nothing(tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text(HEADER + rows(50))
    whole, _ = read(path)
    monkeypatch.setattr(_csv_table, "SIZE", size)
    pieces, _ = read(path)
    assert len(pieces) > 1
    for name in ("x", "y", "speed"):
        assert np.concatenate([p.columns[name] for p in pieces]).tolist() == whole[0].columns[name].tolist()
    assert np.concatenate([p.record for p in pieces]).tolist() == whole[0].record.tolist()


def test_quoted_line_ends(tmp_path: Path) -> None:
    text = 'vehicle_id,timestamp,x,y,note\nA,2026-03-02T05:00:00Z,1,2,"two\nlines"\nA,2026-03-02T05:00:01Z,3,4,one\n'
    batch, _ = one(tmp_path / "a.csv", text)
    assert batch.record.tolist() == [2, 4]
    assert isinstance(batch.columns["note"], Labels)
    assert batch.columns["note"].strings() == ["two\nlines", "one"]


@pytest.mark.parametrize("size", range(40, 400, 7))
def test_no_block_tears_a_quoted_cell(tmp_path: Path, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cells are those of the standard library's reader, wherever a block ends."""
    notes = ['"two\nlines"', "plain", '"a ""b""\n, c"', '""', '"three\n\nlines, 7"']
    path = tmp_path / "a.csv"
    path.write_text(
        "vehicle_id,timestamp,x,y,note\n"
        + "".join(f"A,2026-03-02T05:00:{i:02d}Z,{i},2,{notes[i % 5]}\n" for i in range(60))
    )
    monkeypatch.setattr(_csv_table, "SIZE", size)
    batches, report = read(path)
    assert len(batches) > 5 and not report.damage and not any(b.rejects for b in batches)
    with path.open(newline="") as stream:
        wanted = [row["note"] for row in csv.DictReader(stream)]
    notes_read = [n for b in batches for n in b.columns["note"].strings()]
    assert [n or "" for n in notes_read] == wanted
    assert np.concatenate([b.columns["x"] for b in batches]).tolist() == list(range(60))


def test_a_quote_that_never_closes_holds_no_block_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text(HEADER + rows(5) + rows(400, 5).replace(",", ',"', 1))
    monkeypatch.setattr(_csv_table, "SIZE", 400)
    monkeypatch.setattr(_csv_table, "TORN", 200)
    batches, _ = read(path)
    assert sum(len(b) + len(b.rejects) for b in batches) == 405
    assert len(batches) > 20


def test_own_columns_are_kept(tmp_path: Path) -> None:
    text = "vehicle_id,timestamp,x,y,Mode,odo\nA,2026-03-02T05:00:00Z,1,2,eco,7.5\n"
    batch, _ = one(tmp_path / "a.csv", text)
    assert batch.columns["odo"].tolist() == [7.5]
    assert batch.columns["Mode"].strings() == ["eco"]


SPELLINGS = {
    "lat": ("latitude", None), "LON": ("longitude", None), "Battery Power [kW]": ("battery_power", "kW"),
    "speed_kmh": ("speed", "km/h"), "Speed (mph)": ("speed", "mph"), "SOC [%]": ("soc", "%"), "amb_f": ("ambient_temperature", "degF"),
    "elev_ft": ("z", "ft"), "Course [°]": ("heading", "compass_deg"), "payload_t": ("payload", "t"), "time": ("timestamp", None),
    "vehicleId": ("vehicle_id", None), "id": ("vehicle_id", None), "heading": ("heading", None), "volts": ("battery_voltage", None),
}  # fmt: skip


@pytest.mark.parametrize("name", SPELLINGS)
def test_spellings(name: str) -> None:
    meaning = recognise(name)
    assert meaning is not None
    assert (meaning.column, meaning.unit.name if meaning.unit else None) == SPELLINGS[name]


@pytest.mark.parametrize(
    "name", ["odo_km", "motor_w", "heading_deg", "note", "latency", "x_accel", "speed_limit", "yaw_deg_s"]
)
def test_no_guess(name: str) -> None:
    assert recognise(name) is None


def test_units_are_those_of_the_standards() -> None:
    """Values of NIST SP 811, B.8, and of the compass."""
    si = {("km/h", 36.0): 10.0, ("mph", 10.0): 4.4704, ("kn", 1.0): 0.514444, ("ft", 1.0): 0.3048, ("lb", 1.0): 0.45359237,
          ("degF", 32.0): 0.0, ("degF", 212.0): 100.0, ("K", 273.15): 0.0, ("%", 50.0): 0.5, ("compass_deg", 90.0): 0.0,
          ("compass_deg", 0.0): np.pi / 2, ("compass_deg", 270.0): np.pi, ("compass_deg", 180.0): -np.pi / 2}  # fmt: skip
    for (name, value), expected in si.items():
        unit = next(u for u in UNITS if u.name == name)
        assert unit.to_si(np.array([value]))[0] == pytest.approx(expected, abs=1e-6), name
    assert find_unit("KM/H", "speed") is None or find_unit("kmh", "speed") is not None


def test_two_columns_for_one_meaning(tmp_path: Path) -> None:
    text = "vehicle_id,timestamp,x,y,velocity,speed\nA,2026-03-02T05:00:00Z,1,2,9,3\n"
    batch, report = one(tmp_path / "a.csv", text)
    assert batch.columns["speed"].tolist() == [3.0]
    assert batch.columns["velocity"].tolist() == [9.0]
    assert any("velocity" in n for n in report.notes)


@pytest.mark.parametrize(
    ("text", "degrees"),
    [("49 58.614 N", 49.9769), ("49°58'36.84\"N", 49.9769), ("S 12:30", -12.5), ("9 9.078 W", -9.1513), ("-12 30", -12.5),
     ("49 61 N", None), ("fourty", None), ("N 12 30 S", None)],
)  # fmt: skip
def test_angles_in_cells(text: str, degrees: float | None) -> None:
    value = one_angle(text)
    assert value == (None if degrees is None else pytest.approx(degrees, abs=1e-4))


@given(st.floats(-89.9, 89.9))
def test_packed_minutes_undo_packing(angle: float) -> None:
    whole = np.trunc(angle)
    packed = find_unit("ddmm", "degrees")
    assert packed.to_si(np.array([whole * 100 + (angle - whole) * 60]))[0] == pytest.approx(angle, abs=1e-9)


def test_packed_minutes_by_profile(tmp_path: Path) -> None:
    profile = {"columns": {n: {"column": n, "unit": "ddmm"} for n in ("latitude", "longitude")}}
    batch, _ = one(
        tmp_path / "a.csv", "id,time,latitude,longitude\nA,2026-03-02T05:00:00Z,4958.614,-0909.078\n", profile
    )
    assert [batch.columns[n][0] for n in ("latitude", "longitude")] == pytest.approx([49.9769, -9.1513])


def test_degrees_and_minutes_column(tmp_path: Path) -> None:
    text = "id,time,lat,lon\nA,2026-03-02T05:00:00Z,49 58.614 N,9 09.078 E\nA,2026-03-02T05:00:01Z,49 58.620 N,?\n"
    batch, _ = one(tmp_path / "a.csv", text)
    assert batch.columns["latitude"][0] == pytest.approx(49.9769)
    assert [r.reason for r in batch.rejects] == ["longitude is not a number"]


def test_percent_by_evidence_is_said(tmp_path: Path) -> None:
    batch, report = one(tmp_path / "a.csv", "id,time,x,y,SoC\nA,2026-03-02T05:00:00Z,1,2,97\n")
    assert batch.columns["soc"][0] == pytest.approx(0.97)
    assert "%" in report.recognised["SoC"]


def test_sentinels(tmp_path: Path) -> None:
    text = "id,time,x,y,z,speed\nA,2026-03-02T05:00:00Z,1,2,-111,-3.6\nA,2026-03-02T05:00:01Z,1,2,ERR,0\nA,2026-03-02T05:00:02Z,1,2,5,7.2\n"
    profile = {"sentinels": ["ERR"], "columns": {"z": {"column": "z", "sentinels": [-111]},
               "speed": {"column": "speed", "unit": "km/h", "sentinels": [-3.6]}}}  # fmt: skip
    batch, _ = one(tmp_path / "a.csv", text, profile)
    assert np.array_equal(batch.columns["z"], [np.nan, np.nan, 5.0], equal_nan=True)
    assert np.array_equal(batch.columns["speed"], [np.nan, 0.0, 2.0], equal_nan=True)
    assert not batch.rejects


def test_vehicle_from_the_file(tmp_path: Path) -> None:
    text = "time,x,y\n2026-03-02T05:00:00Z,1,2\n"
    batch, report = one(tmp_path / "truck.7.csv", text)
    assert batch.vehicle.strings() == ["truck.7"]
    assert any("truck.7" in n for n in report.notes)
    batch, _ = one(tmp_path / "truck.7.csv", text, {"vehicle": "{folder}/{stem}"})
    assert batch.vehicle.strings() == [f"{tmp_path.name}/truck.7"]


ERRORS = {
    "": "empty",
    "a,b,c\n": "no time",
    "1,2,3\n4,5,6\n": "no header",
    "vehicle_id,timestamp,note\nA,2026-03-02T05:00:00Z,x\n": "no known column",
    "vehicle_id,time,x,y\nA,12.5,1,2\n": "unknown unit",
    "vehicle_id,time,x,y\nA,02/03/2026 05:00,1,2\n": "several ways",
}


@pytest.mark.parametrize("text", ERRORS)
def test_one_clear_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises((FormatError, InputError), match=ERRORS[text]) as caught:
        read(path)
    assert "\n" not in caught.value.line() and "a.csv" in caught.value.line()


@pytest.mark.parametrize(
    "content", [bytes(range(256)) * 64, b"%PDF-1.7\n1,2,3\n", codecs.BOM_UTF8, b'{"a": 1, "b": 2}\n']
)
def test_other_files_are_not_taken(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    from fleetlog.importers.csv import sniff

    assert not sniff(path, content)


def test_a_column_that_is_blank_at_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_csv_table, "SIZE", 200)
    lines = [
        f"A,2026-03-02T05:00:{i:02d}Z,1,2,{i if i > 20 else ''},{'ab'[i % 2] if i > 30 else ''},"
        for i in range(50)
    ]
    path = tmp_path / "a.csv"
    path.write_text("vehicle_id,timestamp,x,y,late,word,never\n" + "\n".join(lines) + "\n")
    batches, _ = read(path)
    assert len(batches) > 4 and not any(b.rejects for b in batches)
    late = np.concatenate([b.columns["late"] for b in batches])
    assert np.array_equal(late, [i if i > 20 else np.nan for i in range(50)], equal_nan=True)
    assert batches[-1].columns["word"].strings()[-1] == "b"
    assert np.isnan(batches[-1].columns["never"]).all()


def test_blanks_around_a_vehicle(tmp_path: Path) -> None:
    batch, _ = one(
        tmp_path / "a.csv",
        HEADER
        + " A ,2026-03-02T05:00:00Z,1,2,3\nA,2026-03-02T05:00:01Z,1,2,3\n  ,2026-03-02T05:00:02Z,1,2,3\n",
    )
    assert batch.vehicle.strings() == ["A", "A"] and batch.vehicle.names == ("A",)
    assert [r.reason for r in batch.rejects] == ["the vehicle id is missing"]
