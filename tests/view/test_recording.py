"""What a recording holds is what the dataset holds."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rrd
from fixtures_view import START, plant, write_fleet
from rerun.chunk import RrdReader

from fleetlog import engines
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.errors import DataError
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.view.fleet import Fleet, heights, log_day
from fleetlog.view.recording import write_recording
from fleetlog.view.scene import ways_of
from fleetlog.view.stream import Stream, Tape


def at(trajectory: Trajectory, column: str, time: np.ndarray) -> np.ndarray:
    rows = np.searchsorted(trajectory.time, time)
    assert (trajectory.time[rows] == time).all(), "a time that the dataset does not have"
    return trajectory.floats(column)[rows]


@pytest.mark.parametrize(
    ("signal", "column", "factor"),
    [("speed", "speed", 1), ("power", "battery_power", 1e-3), ("soc", "soc", 100)],
)
def test_curves_are_rows_of_the_dataset(
    replay: tuple[Path, Path], signal: str, column: str, factor: float
) -> None:
    dataset, out = replay
    for vehicle in Dataset(dataset).vehicles:
        truth = Dataset(dataset).read(vehicle)
        time, values = rrd.scalars(out, f"/{signal}/{vehicle}".replace(" ", "\\ "))
        known = np.isfinite(values)
        np.testing.assert_allclose(values[known], factor * at(truth, column, time[known]))
        # one break, just behind the last row before the gap of 30 s
        before = truth.time[np.argmax(np.diff(truth.time))]
        assert (~known).sum() == 1 and time[~known][0] - before == 1


def test_a_curve_between_kept_rows_is_the_curve_of_the_dataset(replay: tuple[Path, Path]) -> None:
    """Collapsing runs of equal values loses nothing: interpolation gives the decimated rows back."""
    dataset, out = replay
    truth = Dataset(dataset).read("truck 1")
    time, values = rrd.scalars(out, "/speed/truck\\ 1")
    assert len(time) < 0.5 * len(truth)
    rows = truth.time % 500_000 == 0
    known = np.isfinite(values)
    np.testing.assert_allclose(
        np.interp(truth.time[rows], time[known], values[known]), truth.floats("speed")[rows]
    )


def test_trucks_stand_where_the_dataset_says(replay: tuple[Path, Path]) -> None:
    dataset, out = replay
    for vehicle in Dataset(dataset).vehicles:
        truth = Dataset(dataset).read(vehicle)
        time, xyz = rrd.vectors(out, f"/trucks/{vehicle}".replace(" ", "\\ "), "Transform3D:translation")
        np.testing.assert_allclose(xyz[:, 0], at(truth, "x", time), atol=1e-4)
        np.testing.assert_allclose(xyz[:, 1], at(truth, "y", time), atol=1e-4)
        time, q = rrd.vectors(out, f"/trucks/{vehicle}/body".replace(" ", "\\ "), "Transform3D:quaternion")
        _, scale = rrd.vectors(out, f"/trucks/{vehicle}/body".replace(" ", "\\ "), "Transform3D:scale")
        shown = scale[:, 0] == 1.0
        turned = 2 * np.arctan2(q[shown, 2], q[shown, 3]) - at(truth, "heading", time[shown])
        np.testing.assert_allclose(np.cos(turned), 1.0, atol=1e-3)


def test_heights_come_from_the_road_where_the_log_has_none(replay: tuple[Path, Path]) -> None:
    """The fixture's log has no z; its road from b to c climbs 1.5 m over 40 m."""
    _, out = replay
    _, xyz = rrd.vectors(out, "/trucks/truck\\ 1", "Transform3D:translation")
    on_ramp = np.isclose(xyz[:, 0], 60.0) & (xyz[:, 1] > 1) & (xyz[:, 1] < 39)
    assert on_ramp.sum() > 10
    np.testing.assert_allclose(xyz[on_ramp, 2], xyz[on_ramp, 1] * 1.5 / 40.0, atol=2e-3)


@pytest.mark.parametrize(
    ("z", "matched", "expected"),
    [(131.0, True, 0.75), (131.0, False, 0.0), (2.5, False, 2.5), (2.5, True, 0.75)],
)
def test_height_above_the_sea_is_not_drawn(z: float, matched: bool, expected: float) -> None:
    """Half-way up the ramp from b to c the road is at 0.75 m."""
    columns = {"x": np.array([60.0]), "y": np.array([20.0]), "z": np.array([z])}
    if matched:
        columns |= {"edge_id": Labels.of(["bc"]), "edge_offset": np.array([np.hypot(20.0, 0.75)])}
    t = Trajectory("v", np.array([START]), columns)
    assert heights(t, plant())[0] == pytest.approx(expected)


def test_truck_vanishes_in_a_gap_and_at_its_end(replay: tuple[Path, Path]) -> None:
    _, out = replay
    time, scale = rrd.vectors(out, "/trucks/truck\\ 1/body", "Transform3D:scale")

    def shown(second: float) -> bool:
        return bool(scale[np.searchsorted(time, START + int(second * 1e6), side="right") - 1, 0] > 0.5)

    assert shown(100) and shown(155) and not shown(170) and shown(181) and shown(239) and not shown(251)


def test_load_and_soc_bar(replay: tuple[Path, Path]) -> None:
    _, out = replay
    time, boxes = rrd.column(out, "/trucks/truck\\ 1/body/fork/load", "Boxes3D:half_sizes")
    assert [(int(t - START) // 1_000_000, len(b)) for t, b in zip(time, boxes.to_pylist(), strict=True)] == [
        (0, 0), (60, 1), (120, 0), (180, 1)
    ]  # fmt: skip
    time, strips = rrd.column(out, "/trucks/truck\\ 1/soc", "LineStrips3D:strips")
    _, colours = rrd.column(out, "/trucks/truck\\ 1/soc", "LineStrips3D:colors")
    seen = {}
    for t, row, colour in zip(time, strips.to_pylist(), colours.to_pylist(), strict=True):
        if row:
            full, rest = (s[1][0] - s[0][0] for s in row)
            soc = 0.9 - 0.8 * (t - START) * 1e-6 / 240.0
            assert full / (full + rest) == pytest.approx(soc, abs=0.01)
            seen.setdefault(colour[0], []).append(soc)
    green, yellow, red = seen.values()
    assert min(green) > 0.49 and 0.19 < min(yellow) < max(yellow) < 0.51 and max(red) < 0.21


def test_trail_ends_at_the_truck_and_never_runs_ahead(replay: tuple[Path, Path]) -> None:
    dataset, out = replay
    truth = Dataset(dataset).read("truck 1")
    time, strips = rrd.column(out, "/trail/truck\\ 1", "LineStrips3D:strips")
    ends = np.array([row[0][-1] for row in strips.to_pylist()])
    np.testing.assert_allclose(ends[:, 0], at(truth, "x", time), atol=1e-4)
    longest = max(np.ptp(np.array(row[0]), axis=0).max() for row in strips.to_pylist())
    assert longest < 10.0, "a trail across the gap"


def test_map_positions(replay: tuple[Path, Path]) -> None:
    dataset, out = replay
    time, where = rrd.vectors(out, "/geo/truck\\ 1", "GeoPoints:positions")
    x, y = Dataset(dataset).site.frame.to_local(where[:, 0], where[:, 1])
    truth = Dataset(dataset).read("truck 1")
    np.testing.assert_allclose(
        np.column_stack([x, y]), np.column_stack([at(truth, "x", time), at(truth, "y", time)]), atol=1e-5
    )


ALL = {"Site", "Plan", "Map", "Speed [m/s]", "Battery power [kW]", "State of charge [%]", "Summary"}


@pytest.mark.parametrize(
    ("site", "left_out", "missing"),
    [
        ({}, (), set()),
        ({"frame": False}, (), {"Map"}),
        ({"network": False}, ("z",), set()),
        ({}, ("battery_power", "soc"), {"Battery power [kW]", "State of charge [%]"}),
        ({}, ("heading", "payload", "fork_height", "speed", "soc"), {"Speed [m/s]", "State of charge [%]"}),
    ],
)
def test_no_view_without_its_data(
    tmp_path: Path, site: dict, left_out: tuple[str, ...], missing: set[str]
) -> None:
    dataset = write_fleet(tmp_path / "d", plant(**site), 1, **dict.fromkeys(left_out, True))
    out = write_recording(dataset, tmp_path / "r.rrd")
    assert rrd.views(out) == ALL - missing


def test_without_a_map_the_ways_driven_are_drawn(tmp_path: Path) -> None:
    """In pieces: not across the gap of 30 s, in which the truck came 40 m further."""
    dataset = write_fleet(tmp_path / "d", plant(network=False), 1)
    out = write_recording(dataset, tmp_path / "r.rrd")
    _, strips = rrd.column(out, "/site/driven/truck\\ 1", "LineStrips3D:strips", None)
    (lines,) = strips.to_pylist()
    assert len(lines) == 2
    driven = sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines)
    assert driven == pytest.approx(2.0 * (4 * 30 + 2 * 30 - 20), rel=0.1)
    where = rrd.column(out, "/geo/driven/truck\\ 1", "GeoLineStrings:line_strings", None)[1].to_pylist()[0]
    x, _ = plant().frame.to_local(*np.array(where[0]).T)
    np.testing.assert_allclose(x, np.array(lines[0])[:, 0], atol=1e-4)


def test_several_days_are_one_recording(tmp_path: Path) -> None:
    """A truck that is out over midnight, then silent for a day: breaks are where the silence is, not at midnight."""
    day = 86_400_000_000
    midnight = (START // day + 1) * day
    time = np.concatenate(
        [midnight + np.arange(-600, 600) * 1_000_000, midnight + day + np.arange(600) * 1_000_000]
    )
    s = np.arange(len(time), dtype=float)
    with DatasetWriter.create(tmp_path / "d", "recorded", plant(network=False)) as writer:
        writer.write(Trajectory("t", time, {"x": s, "y": 0 * s, "speed": 1 + 0.1 * (s % 2)}))
    out = write_recording(tmp_path / "d", tmp_path / "r.rrd")
    time_out, values = rrd.scalars(out, "/speed/t")
    assert len(values) == len(s) + 1
    assert time_out[np.isnan(values)].tolist() == [midnight + 599_000_001]


def test_rate_bounds_the_rows(tmp_path: Path, replay: tuple[Path, Path]) -> None:
    dataset, _ = replay
    sizes = {}
    for rate in (0.5, 5.0):
        path = write_recording(dataset, tmp_path / f"{rate}.rrd", rate_hz=rate)
        sizes[rate] = len(rrd.vectors(path, "/trucks/truck\\ 1", "Transform3D:translation")[0])
    assert sizes[0.5] < 0.35 * sizes[5.0]
    assert sizes[5.0] <= len(Dataset(dataset).read("truck 1"))


def test_older_recording_stays_when_writing_fails(
    tmp_path: Path, replay: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset, _ = replay
    out = write_recording(dataset, tmp_path / "r.rrd", rate_hz=0.5)
    before = out.read_bytes()
    monkeypatch.setattr("fleetlog.view.recording.log_day", lambda *a: 1 / 0)
    with pytest.raises(DataError, match="ZeroDivisionError"):
        write_recording(dataset, out)
    assert out.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["r.rrd"]


def test_dataset_of_nothing_and_of_unplaced_rows(tmp_path: Path) -> None:
    with DatasetWriter.create(tmp_path / "empty", "recorded", plant()):
        pass
    assert "/site/roads/surface" in rrd.entities(write_recording(tmp_path / "empty", tmp_path / "e.rrd"))
    nowhere = Trajectory("t", START + np.arange(20) * 1_000_000, {"soc": np.linspace(0.9, 0.8, 20)})
    with DatasetWriter.create(tmp_path / "d", "recorded", plant()) as writer:
        writer.write(nowhere)
    out = write_recording(tmp_path / "d", tmp_path / "r.rrd")
    assert len(rrd.scalars(out, "/soc/t")[1]) == 5
    assert rrd.column(out, "/trucks/t", "Transform3D:translation")[1] is None


def test_two_recordings_are_two(tmp_path: Path, replay: tuple[Path, Path]) -> None:
    """The viewer merges files of one recording id; ours must never be merged by accident."""
    dataset, out = replay
    again = write_recording(dataset, tmp_path / "r.rrd", rate_hz=0.5)
    (first,), (second,) = (RrdReader(str(p)).recordings() for p in (out, again))
    assert first.application_id == second.application_id == "fleetlog"
    assert first.recording_id != second.recording_id


def test_summary_is_shown(tmp_path: Path, replay: tuple[Path, Path]) -> None:
    dataset, _ = replay
    copy = shutil.copytree(dataset, tmp_path / "dataset")
    description = json.loads((copy / "dataset.json").read_text())
    description["summary"] = {"rows_rejected": 17, "distance_m": 12_340.0, "matched": 0.987}
    (copy / "dataset.json").write_text(json.dumps(description))
    out = write_recording(copy, tmp_path / "r.rrd", rate_hz=0.5)
    _, text = rrd.column(out, "/summary", "TextDocument:text", None)
    said = text.to_pylist()[0][0]
    for line in ("**3** vehicles", "rows rejected: 17", "driven: 12.3 km", "on a road: 98.7 % of the rows"):
        assert line in said


def test_workers_draw_what_one_process_draws(tmp_path: Path, replay: tuple[Path, Path]) -> None:
    dataset, alone = replay
    with engines.using(2):
        out = write_recording(dataset, tmp_path / "r.rrd")
    assert rrd.entities(out) == rrd.entities(alone)
    for path, name in (
        ("/trucks/truck\\ 1", "Transform3D:translation"), ("/trail/truck\\ 1", "LineStrips3D:strips"),
        ("/trucks/truck\\ 1/dot", "Points3D:positions"), ("/soc/truck\\ 1", "Scalars:scalars"),
    ):  # fmt: skip
        (time, values), (same_time, same) = (rrd.column(file, path, name) for file in (out, alone))
        assert np.array_equal(time, same_time) and str(values) == str(same)


def test_a_vehicle_day_without_rows_is_drawn_as_nothing(replay: tuple[Path, Path]) -> None:
    dataset = Dataset(replay[0])
    fleet = Fleet(dataset, 2.0)
    lane, date = fleet.lanes(None)[0], dataset.dates[0]
    sent, nothing = Tape(), Tape()
    day = fleet.day(lane.vehicle, date)
    assert log_day(Stream(sent), lane, day, dataset.site, True) and len(day) and sent
    assert not log_day(Stream(nothing), lane, day[:0], dataset.site, True)
    assert not nothing and not ways_of(day[:0])
    assert not len(fleet.day(lane.vehicle, "1999-01-01"))
