"""Logs with silences of hours and weeks: skipped in the replay, cut out of curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rrd
from fixtures_view import START, drive, plant, write_fleet
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.result import Result, Series
from fleetlog.core.trajectory import Trajectory
from fleetlog.errors import InputError
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.view.clock import MINUTE, SKIPPED, Clock, clock_of
from fleetlog.view.picture import _over_time
from fleetlog.view.recording import write_recording
from fleetlog.view.results import write_result_recording
from fleetlog.view.viewer import describe_recording

DAY = 86_400_000_000


@st.composite
def clocks(draw: st.DrawFn) -> Clock:
    edges = np.cumsum(draw(st.lists(st.integers(1, 10**9), min_size=2, max_size=20)))
    edges = edges[: len(edges) // 2 * 2]
    return Clock(edges[::2], edges[1::2])


@given(clocks(), st.lists(st.integers(0, 2 * 10**10), min_size=1, max_size=30))
def test_time_passes_in_stretches_with_data_and_stands_still_between(
    clock: Clock, moments: list[int]
) -> None:
    time = np.sort(np.array(moments, np.int64))
    passed = np.diff(clock(time))
    inside = [
        np.clip(time[1:], a, b) - np.clip(time[:-1], a, b)
        for a, b in zip(clock.starts, clock.ends, strict=True)
    ]
    assert (passed == np.sum(inside, axis=0)).all()
    assert clock(clock.starts[:1])[0] == 0
    assert clock(clock.ends[-1:])[0] * 1e-6 == pytest.approx(clock.seconds)


@pytest.fixture(scope="module")
def weeks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four minutes on each of three days, the last one three weeks later."""
    path, site = tmp_path_factory.mktemp("weeks") / "dataset", plant()
    with DatasetWriter.create(path, "recorded", site) as writer:
        writer.provenance = {"command": "test"}
        for days in (0, 1, 21):
            t = drive(site, "T1", 0.0)
            writer.write(Trajectory("T1", t.time + days * DAY, t.columns))
    return path


def test_silences_of_the_fleet_are_skipped(weeks: Path, tmp_path: Path) -> None:
    clock = clock_of(Dataset(weeks))
    assert clock is not None and len(clock.starts) == 3
    assert clock.seconds == pytest.approx(3 * 240.0, abs=120.0)
    out = write_recording(weeks, tmp_path / "r.rrd")
    assert describe_recording(out)["recordings"][0]["timelines"] == [SKIPPED, "utc"]
    utc, _ = rrd.column(out, "/speed/T1", "Scalars:scalars")
    played, _ = rrd.column(out, "/speed/T1", "Scalars:scalars", SKIPPED)
    assert np.ptp(utc) > 20 * DAY and np.ptp(played) <= clock.seconds * 1e6
    assert (played == clock(utc)).all()


def test_an_unbroken_log_has_the_timeline_of_the_clock_alone(tmp_path: Path) -> None:
    path = write_fleet(tmp_path / "dataset", plant())
    assert clock_of(Dataset(path)) is None
    out = write_recording(path, tmp_path / "r.rrd")
    assert describe_recording(out)["recordings"][0]["timelines"] == ["utc"]


@pytest.mark.parametrize(("step", "silent"), [(MINUTE, True), (60 * MINUTE, False)])
def test_the_recording_of_an_analysis_skips_silences(tmp_path: Path, step: int, silent: bool) -> None:
    """But no steps between the values of a curve: every one would be a period of its own."""
    x = START + np.concatenate([np.arange(20) * step, np.arange(20) * step + 20 * 60 * MINUTE + DAY * silent])
    curve = Series("power", x, {"a": np.ones(40)}, "time", "power [kW]", over_time=True)
    out = write_result_recording(Result("energy", {}, shapes=[curve]), plant(), tmp_path / "r.rrd")
    assert describe_recording(out)["recordings"][0]["timelines"] == [SKIPPED] * silent + ["utc"]
    utc, _ = rrd.column(out, "/curves/power/a", "Scalars:scalars")
    assert {utc[0], utc[-1]} == {x[0], x[-1]}


@pytest.mark.parametrize(("points", "step"), [(2, MINUTE), (3, MINUTE), (30, MINUTE), (8, 60 * MINUTE)])
def test_no_curve_runs_across_a_silence(points: int, step: int) -> None:
    from matplotlib.figure import Figure

    shift = np.arange(points) * step
    x = START + np.concatenate([shift, shift + DAY, shift + 21 * DAY])
    _, values = _over_time(Figure().add_subplot(), x, np.ones((1, len(x))), "UTC")
    assert np.flatnonzero(np.isnan(values[0])).tolist() == [points, 2 * points + 1]


def test_a_day_is_shown_as_if_it_were_the_dataset(weeks: Path, tmp_path: Path) -> None:
    day = str(np.datetime64(START + DAY, "us"))[:10]
    out = write_recording(weeks, tmp_path / "day.rrd", day=day)
    assert describe_recording(out)["recordings"][0]["timelines"] == ["utc"]
    whole, speeds = rrd.scalars(write_recording(weeks, tmp_path / "all.rrd"), "/speed/T1")
    mine = (whole // DAY == (START + DAY) // DAY) & np.isfinite(speeds)
    shown, of_day = rrd.scalars(out, "/speed/T1")
    known = np.isfinite(of_day)
    assert np.array_equal(shown[known], whole[mine]) and np.array_equal(of_day[known], speeds[mine])
    assert known.sum() > 15


def test_a_day_without_rows_is_told_with_those_that_have_some(weeks: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no rows on 2026-01-31"):
        write_recording(weeks, tmp_path / "day.rrd", day="2026-01-31")
    assert not (tmp_path / "day.rrd").exists()
