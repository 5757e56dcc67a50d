"""Times: ISO 8601 in its forms, counts, formats, local time with daylight saving."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.errors import InputError
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import load_profile, profile_from_dict
from fleetlog.importers._units import NONE, LocalClock, epoch_unit, from_counts, from_format, from_iso
from fleetlog.importers.base import ReadOptions
from fleetlog.importers.csv import read

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
moments = st.datetimes(datetime(1975, 1, 2), datetime(2099, 1, 1)).map(lambda d: d.replace(tzinfo=UTC))


def micro(when: datetime) -> int:
    return (when - EPOCH) // timedelta(microseconds=1)


@given(moments, st.sampled_from(["Z", "+02:00", "-05:30", ""]), st.sampled_from(["T", " "]))
def test_iso(when: datetime, zone: str, between: str) -> None:
    offset = {"Z": 0, "": 0, "+02:00": 120, "-05:30": -330}[zone]
    text = (when + timedelta(minutes=offset)).replace(tzinfo=None).isoformat(between) + zone
    time, bare = from_iso(pa.array([text]))
    assert time[0] == micro(when) and bare[0] == (zone == "")
    # among cells that are not times, and with another style of zone, the same
    time, bare = from_iso(pa.array([text, None, "soon", "2026-03-02"]))
    assert time[0] == micro(when) and time[1] == time[2] == NONE and bare[0] == (zone == "")


def test_nanoseconds_are_cut() -> None:
    assert from_iso(pa.array(["2026-03-02T05:00:00.123456789Z"]))[0][0] % 1_000_000 == 123456


@given(moments)
def test_counts_are_told_apart_by_their_size(when: datetime) -> None:
    for unit, factor in {"s": 1e-6, "ms": 1e-3, "us": 1.0}.items():
        values = np.array([micro(when) * factor])
        assert epoch_unit(values) == unit
        assert abs(int(from_counts(values, unit)[0]) - micro(when)) <= 1
    assert epoch_unit(np.array([micro(when) * 1e3])) == "ns"
    assert from_counts(np.array([micro(when) * 1000 + 7]), "ns")[0] == micro(when)


@pytest.mark.parametrize("value", [12.5, 1e5, 3e7, float("nan")])
def test_small_counts_are_not_guessed(value: float) -> None:
    assert epoch_unit(np.array([value])) is None


def test_formats() -> None:
    time, bare = from_format(
        pa.array(["7/1/2021 10:34:36", "07/01/2021 10:34:37", "33/01/2021 10:00:00", None]),
        "%m/%d/%Y %H:%M:%S",
    )
    assert time[0] == micro(datetime(2021, 7, 1, 10, 34, 36, tzinfo=UTC)) and time[1] == time[0] + 1_000_000
    assert time[2] == time[3] == NONE and bare.all()
    assert (
        from_format(pa.array(["02.03.2026 05:00:00.25"]), "%d.%m.%Y %H:%M:%S.%f")[0][0] % 1_000_000 == 250_000
    )


@given(st.integers(0, 4 * 3600 * 24 * 365))
def test_local_clock_agrees_with_zoneinfo(seconds: int) -> None:
    """Outside the hours that come twice, the standard library is the authority."""
    zone = ZoneInfo("Europe/Berlin")
    when = datetime(2022, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    shown = when.astimezone(zone).replace(tzinfo=None)
    if shown.replace(tzinfo=zone, fold=0).utcoffset() != shown.replace(tzinfo=zone, fold=1).utcoffset():
        return
    local = np.array([micro(shown.replace(tzinfo=UTC))])
    assert LocalClock(zone).to_utc(local, np.array(["A"], object))[0] == micro(when)


def test_the_hour_that_comes_twice_is_told_apart_by_order() -> None:
    """2026-10-25 in Berlin: 02:00 to 03:00 comes twice.  Two trucks, interleaved, across blocks."""
    zone = ZoneInfo("Europe/Berlin")
    start = datetime(2026, 10, 25, 0, 30, tzinfo=UTC)  # 02:30 summer time
    truth = [start + timedelta(minutes=m) for m in range(-90, 120, 10) for _ in "AB"]
    vehicle = np.array(["A", "B"] * (len(truth) // 2), object)
    local = np.array([micro(t.astimezone(zone).replace(tzinfo=UTC)) for t in truth])
    for size in (len(truth), 7, 1):
        clock = LocalClock(zone)
        out = np.concatenate(
            [clock.to_utc(local[i : i + size], vehicle[i : i + size]) for i in range(0, len(local), size)]
        )
        assert out.tolist() == [micro(t) for t in truth]
        assert clock.twice == 24


def test_a_time_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        "id;time;x;y\nA;2026-03-29 01:59:00;1;2\nA;2026-03-29 02:30:00;1;2\nA;2026-03-29 03:00:00;1;2\n"
    )
    report = ReadReport(path)
    batch = next(
        iter(read(path, ReadOptions(report, profile_from_dict({"time": {"zone": "Europe/Berlin"}}))))
    )
    assert np.diff(batch.time).tolist() == [60_000_000]
    assert len(batch.rejects) == 1 and "does not exist" in batch.rejects[0].reason


def test_split_date_and_time(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id,Date,Time,x,y\nA,2026-03-02,05:00:00,1,2\nA,2026-03-02,,1,2\n")
    report = ReadReport(path)
    batch = next(iter(read(path, ReadOptions(report))))
    assert batch.time.tolist() == [micro(datetime(2026, 3, 2, 5, tzinfo=UTC))]
    assert [r.reason for r in batch.rejects] == ["the time is missing"]
    assert set(report.recognised) >= {"Date", "Time"}
    assert any("UTC" in n for n in report.notes)


def test_seconds_from_a_stated_origin(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id,t_s,x,y\nA,0.5,1,2\n")
    time = {"column": "t_s", "format": "s", "origin": "2026-03-02T05:00:00Z"}
    batch = next(iter(read(path, ReadOptions(ReadReport(path), profile_from_dict({"time": time})))))
    assert batch.time.tolist() == [micro(datetime(2026, 3, 2, 5, tzinfo=UTC)) + 500_000]


PROFILES = {
    "delimeter = ';'": "delimiter",
    "[time]\ncolum = 'T'": "column",
    "[time]\nzone = 'Europe/Berlim'": "Europe/Berlin",
    "[time]\nformat = 'epoch'": "strptime",
    "[columns]\nspede = 'v'": "speed",
    "[columns]\nspeed = { column = 'v', unit = 'kmph/h' }": "km/h",
    "[columns]\nspeed = { column = 'v', units = 'km/h' }": "unit",
    "[columns]\ntimestamp = 'T'": "[time]",
    "encoding = 'latin-99'": "latin-1",
    "skip_lines = 'two'": "not a whole number",
    "a = ": "TOML",
}


@pytest.mark.parametrize("text", PROFILES)
def test_a_wrong_profile_says_what_is_meant(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_profile(path)
    assert PROFILES[text] in caught.value.line() and "p.toml" in caught.value.line()


def test_a_profile_names_a_column_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id,time,x,y,Velocity\nA,2026-03-02T05:00:00Z,1,2,3\n")
    with pytest.raises(InputError, match="Velocity"):
        list(read(path, ReadOptions(ReadReport(path), profile_from_dict({"columns": {"speed": "Velocty"}}))))
