"""Logs as plants write them: units, names, clocks. The same rows in other words are the same, or it is said."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.errors import FormatError
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import profile_from_dict
from fleetlog.importers._units import KINDS, UNITS, Unit, epoch_unit, nearly, normal, recognise
from fleetlog.importers.base import RawBatch, ReadOptions, detect, read_guarded

START = 1_772_427_600  # 2026-03-02 05:00 UTC [s]
STAMPS = [f"2026-03-02T05:00:{i:02d}Z" for i in range(6)]
PLACES = [[49.97 + i * 1e-5 for i in range(6)], [9.15 + i * 1e-5 for i in range(6)]]
SPEEDS = [0.5, 1.0, 1.5, 2.0, 1.5, 1.0]
MEASURED = sorted(
    KINDS.keys() & {"speed", "payload", "fork_height", "battery_power", "battery_voltage", "soc"}
)


def one(path: Path, text: str | bytes, profile: dict[str, Any] | None = None) -> tuple[RawBatch, ReadReport]:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    importer, options = detect(path), None
    report = ReadReport(path, importer.name)
    options = ReadOptions(report, profile_from_dict(profile) if profile else None)
    (batch,) = read_guarded(importer, path, options)
    return batch, report


def table(header: str, *cells: list[Any], separator: str = ",") -> str:
    rows = (separator.join(map(str, row)) for row in zip(*cells, strict=True))
    return "\n".join([header, *rows]) + "\n"


def written(unit: Unit, si: float) -> float:
    return si / unit.factor - unit.shift


@pytest.mark.parametrize("column", MEASURED)
def test_a_line_of_units_below_the_header_counts_whatever_the_unit(tmp_path: Path, column: str) -> None:
    for unit in (u for u in UNITS if u.kind == KINDS[column]):
        cells = [f"{written(unit, 0.5):.12g}"] * 6
        header = f"AGV,time,lat,lon,{column}\n-,UTC,deg,[°],{unit.name}"  # also 1, of shares
        batch, report = one(tmp_path / "a.csv", table(header, ["T1"] * 6, STAMPS, *PLACES, cells))
        assert np.allclose(batch.columns[column], 0.5, rtol=1e-9), unit
        assert (len(batch), batch.record[0], batch.rejects) == (6, 3, [])
        assert any("line 2 holds units" in note for note in report.notes)


def test_what_is_no_unit_is_said_and_never_taken_for_the_dataset_s(tmp_path: Path) -> None:
    text = table(
        "time,lat,lon,speed,soc,note\nhh:mm:ss,WGS84,WGS84,furlong/h,%,text",
        STAMPS,
        *PLACES,
        SPEEDS,
        [75] * 6,
        "abcdef",
    )
    batch, report = one(tmp_path / "a.csv", text)
    assert "speed" not in batch.columns and batch.columns["speed [furlong/h]"].tolist() == SPEEDS
    assert batch.columns["soc"].tolist() == [0.75] * 6 and "latitude" in batch.columns
    assert any("'speed [furlong/h]' may be the speed" in note for note in report.notes)
    # a profile goes before the line
    said = {"columns": {"speed": {"column": "speed", "unit": "km/h"}}}
    batch, _ = one(tmp_path / "b.csv", text, said)
    assert np.allclose(batch.columns["speed"], np.array(SPEEDS) / 3.6)


def test_a_first_row_of_figures_or_of_words_is_no_line_of_units(tmp_path: Path) -> None:
    batch, report = one(tmp_path / "a.csv", table("time,x,y,mode", STAMPS, [1] * 6, [2] * 6, "ABCDEF"))
    assert (len(batch), report.notes[:1] and "units" in report.notes[0]) == (6, False)


@pytest.mark.parametrize(
    ("name", "column"), [("Speed [furlong]", "speed"), ("heading_deg", "heading"), ("Last [kg]", None)]
)
def test_a_column_that_only_lacks_a_known_unit_is_named(name: str, column: str | None) -> None:
    assert recognise(name) is None
    assert nearly(name) == column


@pytest.mark.parametrize("titles", ["Fleet export v3\n", "Report\nof 2026\n\n", "\ufeffDemo\n"])
def test_titles_above_the_header_are_left_out_and_said(tmp_path: Path, titles: str) -> None:
    batch, report = one(tmp_path / "a.csv", titles + table("time,lat,lon", STAMPS, *PLACES))
    assert len(batch) == 6
    assert any("above the header left out" in note for note in report.notes)
    assert batch.record[0] == titles.count("\n") + 2


def test_quoted_figures_may_have_a_decimal_comma(tmp_path: Path) -> None:
    def quoted(values: list[float]) -> list[str]:
        return [f'"{v:.6f}"'.replace(".", ",") for v in values]

    batch, _ = one(tmp_path / "a.csv", table("time,lat,lon,speed", STAMPS, *map(quoted, (*PLACES, SPEEDS))))
    assert batch.columns["speed"].tolist() == SPEEDS
    assert np.allclose(batch.columns["latitude"], PLACES[0])
    # three digits behind a comma are thousands, or nothing
    batch, _ = one(tmp_path / "b.csv", table("time,lat,lon,power", STAMPS, *PLACES, ['"1,234.5"'] * 6))
    assert batch.columns["battery_power"].tolist() == [1234.5] * 6


@pytest.mark.parametrize(
    ("header", "separator"),
    [
        (
            "Fahrzeug;Zeitstempel;Breitengrad;Längengrad;Geschwindigkeit [km/h];Ladezustand [%];Spannung [V]",
            ";",
        ),
        ("véhicule,horodatage,latitude,longitude,vitesse (km/h),état de charge (%),tension (V)", ","),
        ("vehículo\tfecha_hora\tlatitud\tlongitud\tvelocidad_kmh\testado_de_carga_%\tvoltaje", "\t"),
        ("Unit,t,lat,long,Speed (KM/H),SOC (pct),Volts", ","),
    ],
)
def test_names_in_other_languages(tmp_path: Path, header: str, separator: str) -> None:
    header = header.replace("_%", " [%]")
    cells = [["T1", "T2"] * 3, STAMPS, *PLACES, [v * 3.6 for v in SPEEDS], [75] * 6, [48.5] * 6]
    batch, _ = one(tmp_path / "a.csv", table(header, *cells, separator=separator).encode("cp1252"))
    assert batch.vehicle.strings() == ["T1", "T2"] * 3
    assert np.allclose(batch.columns["speed"], SPEEDS)
    assert (batch.columns["soc"][0], batch.columns["battery_voltage"][0]) == (0.75, 48.5)
    assert np.allclose(batch.columns["latitude"], PLACES[0]) and np.allclose(
        batch.columns["longitude"], PLACES[1]
    )


def test_names_without_their_accents() -> None:
    assert [normal(n) for n in ("Längengrad", "Véhicule", "Außentemperatur", "batteryPower")] == [
        "langengrad", "vehicule", "aussentemperatur", "battery_power",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "name", ["AGV", "Fahrzeug", "unit_no", "Vehicle No", "Truck No.", "Flurförderzeug", "AMR", "equipo"]
)
def test_columns_that_name_the_vehicle(name: str) -> None:
    meaning = recognise(name)
    assert meaning is not None and meaning.column == "vehicle_id"


def test_t_is_a_time_only_where_no_other_column_is(tmp_path: Path) -> None:
    seconds = list(range(START, START + 6))
    assert one(tmp_path / "a.csv", table("t,x,y", seconds, [0] * 6, SPEEDS))[0].time[0] == START * 1_000_000
    batch, _ = one(tmp_path / "b.csv", table("T,time,x,y", [21.5] * 6, STAMPS, [0] * 6, SPEEDS))
    assert batch.time[0] == START * 1_000_000 and batch.columns["T"].tolist() == [21.5] * 6


def test_names_that_may_mean_anything_give_way(tmp_path: Path) -> None:
    local = [s.replace("T05", " 06").rstrip("Z") for s in STAMPS]
    cells = [local, ["km"] * 6, STAMPS, ["A"] * 6, SPEEDS, SPEEDS]
    batch, _ = one(tmp_path / "a.csv", table("local_time,unit,time,truck,x,y", *cells))
    assert (batch.time[0], batch.vehicle.strings()) == (START * 1_000_000, ["A"] * 6)
    batch, report = one(tmp_path / "b.csv", table("local_time,unit,x,y", local, ["A"] * 6, SPEEDS, SPEEDS))
    assert batch.vehicle.strings() == ["A"] * 6 and any("no zone" in note for note in report.notes)


@given(st.floats(-3.1, 3.1))
def test_a_course_in_radians_is_the_heading_of_that_in_degrees(heading: float) -> None:
    course = math.pi / 2 - heading
    for name, value in (
        ("course", math.degrees(course)),
        ("course [rad]", course),
        ("bearing_deg", math.degrees(course)),
    ):
        meaning = recognise(name)
        assert meaning is not None and meaning.unit is not None
        assert meaning.unit.to_si(np.array([value]))[0] == pytest.approx(heading, abs=1e-9)


@pytest.mark.parametrize("style", ["%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f"])
def test_dates_with_dots_have_the_day_first(tmp_path: Path, style: str) -> None:
    moments = [datetime.fromtimestamp(START + i, UTC) for i in range(6)]
    cells = [[m.strftime(style).split()[k] for m in moments] for k in (0, 1)]
    text = table("Datum;Uhrzeit;x;y", *cells, SPEEDS, SPEEDS, separator=";")
    batch, report = one(tmp_path / "a.csv", text)
    assert batch.time.tolist() == [(START + i) * 1_000_000 for i in range(6)]
    assert "day before the month" in report.recognised["Datum"]
    batch, _ = one(tmp_path / "b.csv", text, {"time": {"zone": "Europe/Berlin"}})
    assert batch.time[0] == (START - 3600) * 1_000_000
    with pytest.raises(FormatError, match="several ways"):  # the month first, or none
        one(tmp_path / "c.csv", text.replace("02.03.2026", "03.29.2026"))


def test_the_days_of_a_spreadsheet(tmp_path: Path) -> None:
    local = 46205 + 7 / 24  # 2026-07-02 07:00 in Berlin, two hours before UTC in summer
    text = table("time,x,y", [f"{local + i / 86400:.10f}" for i in range(6)], SPEEDS, SPEEDS)
    with pytest.raises(FormatError) as error:
        one(tmp_path / "a.csv", text)
    assert "spreadsheet" in error.value.line()
    said = {"time": {"format": "days", "origin": "1899-12-30", "zone": "Europe/Berlin"}}
    batch, _ = one(tmp_path / "a.csv", text, said)
    assert np.abs(batch.time - (1_782_968_400 + np.arange(6)) * 1_000_000).max() < 50
    assert epoch_unit(local) is None  # never guessed


def test_clocks_that_may_be_false_are_said(tmp_path: Path) -> None:
    def notes(time: str, stamps: list[Any]) -> str:
        return " ".join(one(tmp_path / "a.csv", table(f"{time},x,y", stamps, SPEEDS, SPEEDS))[1].notes)

    assert "2006-07-17" in notes("time", [s.replace("2026-03-02", "2006-07-17") for s in STAMPS])
    assert "(then 2026-03-02)" in notes("time", [s.replace("2026-03-02", "2006-07-17") for s in STAMPS])
    assert "1980-01-06" in notes("time", ["1980-01-06T00:00:01Z", *STAMPS[1:]])
    assert "false" not in notes("time", STAMPS)
    assert "GPS time" in notes("gps_time", [START - 315_964_800 + i for i in range(6)])
    assert "GPS time" not in notes("time", [START - 315_964_800 + i for i in range(6)])
    assert "GPS time" not in notes("gps_time", [START + i for i in range(6)])


def states(stamps: list[Any], theta: float = 0.5, charge: float = 70.0) -> str:
    return "\n".join(
        json.dumps({
            "timestamp": t, "version": "2.0.0", "manufacturer": "M", "serialNumber": "1",
            "agvPosition": {"x": float(i), "y": 0.0, "theta": theta, "mapId": "m", "positionInitialized": True},
            "batteryState": {"batteryCharge": charge, "charging": False},
        })
        for i, t in enumerate(stamps)
    )  # fmt: skip


def messages(path: Path, text: str) -> tuple[list[RawBatch], ReadReport]:
    path.write_text(text)
    report = ReadReport(path, "vda5050")
    return list(read_guarded(detect(path), path, ReadOptions(report))), report


@pytest.mark.parametrize("factor", [1, 1000, 1_000_000, 1_000_000_000])
def test_messages_whose_stamps_count_are_those_with_dates(tmp_path: Path, factor: int) -> None:
    plain, _ = messages(tmp_path / "a.jsonl", states(STAMPS))
    counted, _ = messages(tmp_path / "b.jsonl", states([(START + i) * factor for i in range(6)]))
    texts, _ = messages(tmp_path / "c.jsonl", states([str((START + i) * factor) for i in range(6)]))
    assert [b.time.tolist() for b in counted] == [b.time.tolist() for b in plain]
    assert [b.time.tolist() for b in texts] == [b.time.tolist() for b in plain]


def test_messages_in_degrees_or_shares_are_said(tmp_path: Path) -> None:
    batches, report = messages(tmp_path / "a.jsonl", states(STAMPS, theta=90.0, charge=0.7))
    assert "heading" not in batches[0].columns and batches[0].columns["theta_log"].tolist() == [90.0] * 6
    assert any("theta" in note for note in report.notes) and any("100 times" in note for note in report.notes)
    batches, report = messages(tmp_path / "b.jsonl", states(STAMPS, theta=-0.5))
    assert batches[0].columns["heading"].tolist() == [-0.5] * 6
    assert not any("theta" in note or "100 times" in note for note in report.notes)


def test_why_no_message_could_be_used_is_said(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as error:
        messages(tmp_path / "a.jsonl", states(["yesterday"] * 6))
    assert "6 lines rejected, the first for: no timestamp" in error.value.line()


@pytest.mark.parametrize(("end", "told"), [("Z", False), ("+01:00", False), ("-0530", False), ("", True)])
def test_a_track_whose_times_state_no_zone_is_told_of(tmp_path: Path, end: str, told: bool) -> None:
    points = "".join(f'<trkpt lat="49.9" lon="9.1"><time>{t[:-1]}{end}</time></trkpt>' for t in STAMPS)
    _, report = one(tmp_path / "a.gpx", f'<gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>')
    assert any("no zone" in note for note in report.notes) == told


@pytest.mark.parametrize(("most", "told"), [(0, False), (1, True), (0.8, True), (800, False)])
def test_a_load_that_is_a_flag_or_in_tonnes_is_asked_for(tmp_path: Path, most: float, told: bool) -> None:
    loads = [0, most, 0, most, 0, 0]
    _, report = one(tmp_path / "a.csv", table("AGV,time,x,y,load", ["A"] * 6, STAMPS, SPEEDS, SPEEDS, loads))
    assert any("at most 1 kg" in note for note in report.notes) == told
    _, report = one(
        tmp_path / "b.csv", table("AGV,time,x,y,load_t", ["A"] * 6, STAMPS, SPEEDS, SPEEDS, loads)
    )
    assert not report.notes


def test_where_no_column_is_the_vehicle_those_that_may_be_are_named(tmp_path: Path) -> None:
    _, report = one(tmp_path / "a.csv", table("tug,time,x,y", ["A", "B"] * 3, STAMPS, SPEEDS, SPEEDS))
    assert any("no column of vehicle ids" in note and "'tug'" in note for note in report.notes)
