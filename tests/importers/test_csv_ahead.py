"""A log that threads read ahead: the batches, refusals, notes and errors of one that is read block by block."""

from __future__ import annotations

import gzip
import time
from collections.abc import Iterator
from dataclasses import astuple
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fleetlog import engines
from fleetlog.core.trajectory import Labels
from fleetlog.engines.processes import Processes
from fleetlog.errors import FleetlogError, FormatError
from fleetlog.importers import _csv_table
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Profile, profile_from_dict
from fleetlog.importers.base import ReadOptions
from fleetlog.importers.csv import read

HEADER = b"vehicle_id,timestamp,x,y,soc,note\n"
LINES = {
    "plain": b"A,2026-03-02T05:00:0%dZ,1.5,2,0.5,\n", "per cent": b"B,2026-03-02T05:00:0%dZ,1,2,80,\n",
    "word": b"A,2026-03-02T05:00:0%dZ,1,2,0.5,word\n", "figure": b"B,2026-03-02T05:00:0%dZ,1,2,0.5,7\n",
    "two lines": b'A,2026-03-02T05:00:0%dZ,1,2,0.5,"two\nlines"\n', "no time": b"A,,1,2,0.5,%d\n",
    "short": b"A,2026-03-02T05:00:0%dZ,1,2\n", "open": b'A,2026-03-02T05:00:0%dZ,1,2,0.5,"open\n',
    "return": b"B,2026-03-02T05:00:0%dZ,1,2,0.5,\r", "torn": b"B,2026-03-02T05:00:0%dZ,\r1,2,0.5,\n",
    "cp1252": b"A,2026-03-02T05:00:0%dZ,1,2,0.5,K\xe4fer\n", "no number": b"A,2026-03-02T05:00:0%dZ,one,2,x,\n",
    "no zone": b"A,2026-03-02T05:00:0%d,1,2,0.5,\n", "header": HEADER.replace(b"\n", b"%.0d\n"), "blank": b"%.0d\n",
}  # fmt: skip


def told(path: Path, profile: Profile | None = None) -> list[Any]:
    """All that is read of a log, in its order, the error that ends it, and what is said of it."""
    report, out = ReadReport(path), []
    try:
        for b in read(path, ReadOptions(report, profile)):
            columns = {
                n: v.strings() if isinstance(v, Labels) else repr(v.tolist()) for n, v in b.columns.items()
            }
            out.append((b.vehicle.strings(), b.time.tolist(), columns, b.record.tolist(), b.rejects))
    except FleetlogError as error:
        out.append(error.line())
    return [*out, list(report.recognised.items()), astuple(report)]


def ahead(path: Path, profile: Profile | None = None) -> list[Any]:
    with engines.using(3):
        return told(path, profile)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(_csv_table, "SIZE", 200)
    yield


fixture = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("packed", [False, True])
@given(kinds=st.lists(st.sampled_from([*LINES, *["plain"] * 20]), min_size=1, max_size=80))
@settings(fixture, max_examples=60)
def test_reading_ahead_changes_nothing(tmp_path: Path, small: None, packed: bool, kinds: list[str]) -> None:
    text = HEADER + LINES["plain"] % 0 + b"".join(LINES[kind] % (i % 10) for i, kind in enumerate(kinds))
    path = tmp_path / "a.csv"
    path.write_bytes(gzip.compress(text) if packed else text)
    assert ahead(path) == told(path)


@pytest.mark.parametrize("style", ["%d.%m.%Y %H:%M:%S", "of day"])
def test_times_that_need_their_order(tmp_path: Path, small: None, style: str) -> None:
    """Local times over the hour that comes twice, and times of day over midnight."""
    path, start = tmp_path / "a.csv", datetime(2026, 10, 24, 22)
    if style == "of day":
        said, style = {"origin": "2026-10-24"}, "%H:%M:%S"
    else:
        said = {"zone": "Europe/Berlin", "format": style}
    hours = [22, 23, 24, 25, 26, 26, 27, 28]
    times = [start + timedelta(hours=h - 22, minutes=m) for h in hours for m in range(60)]
    path.write_text("id,time,x,y\n" + "".join(f"A,{t.strftime(style)},1,2\n" for t in times))
    serial = told(path, profile_from_dict({"time": said}))
    assert len(serial) > 20
    assert ahead(path, profile_from_dict({"time": said})) == serial


def test_what_is_said_of_the_file_keeps_its_order(
    tmp_path: Path, small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A block that is found early says its part after the blocks before it, which are still at work."""
    quick = _csv_table.TableReader.read

    def slow(reader: _csv_table.TableReader, block: _csv_table.Block) -> Any:
        time.sleep(0.01)
        return quick(reader, block)

    plain, path = LINES["plain"] % 0 * 12, tmp_path / "a.csv"
    path.write_bytes(HEADER + plain + LINES["cp1252"] % 0 + plain + LINES["return"] % 0 + plain * 3)
    serial = told(path)
    assert [what in note for what, note in zip(("cp1252", "carriage"), serial[-1][3], strict=True)] == [
        True
    ] * 2
    monkeypatch.setattr(_csv_table.TableReader, "read", slow)
    assert ahead(path) == serial


def test_an_error_ahead_waits_for_its_turn(
    tmp_path: Path, small: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What lies before a line without end is read, and the error names the line."""
    monkeypatch.setattr(_csv_table, "LONGEST", 500)
    path = tmp_path / "a.csv"
    path.write_bytes(HEADER + LINES["plain"] % 0 * 50 + b"A," * 1000)
    serial = told(path)
    assert sum(isinstance(part, tuple) for part in serial) > 5 and any("line 52" in str(s) for s in serial)
    assert ahead(path) == serial


def test_what_is_not_asked_for_is_not_read(tmp_path: Path, small: None) -> None:
    """Memory is bounded: no more is drawn than a few jobs a thread, and none after the end."""
    drawn = []
    jobs = (drawn.append(i) or i for i in range(1000))
    results = Processes(2, always=True).stream(str, jobs, 0.0)
    assert [next(results) for _ in range(3)] == ["0", "1", "2"]
    assert len(drawn) < 12
    results.close()
    assert len(drawn) < 12


def test_errors_of_jobs_come_in_their_turn() -> None:
    def failing() -> Iterator[int]:
        yield from (1, 2, 3)
        raise FormatError("broken")

    for engine in (engines.Engine(), Processes(2, always=True)):
        results, seen = engine.stream(str, failing(), 0.0), []
        with pytest.raises(FormatError):
            seen.extend(results)
        assert seen == ["1", "2", "3"]
