"""Export then import gives the same rows, within what the format can hold, for every format that can be read back."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fleetlog.core.trajectory import Labels
from fleetlog.errors import DataError, InputError, OutputError
from fleetlog.exporters import base
from fleetlog.exporters.base import export_dataset
from fleetlog.importers._open import ReadReport
from fleetlog.importers.base import ReadOptions, detect
from fleetlog.store import Dataset

# format: (tolerance of positions [m], of time [us], columns that come back)
FORMATS: dict[str, tuple[float, int, tuple[str, ...]]] = {
    "csv": (
        0.0,
        0,
        ("heading", "speed", "payload", "soc", "battery_current", "edge_offset", "my_signal", "z"),
    ),
    "parquet": (
        0.0,
        0,
        ("heading", "speed", "payload", "soc", "battery_current", "edge_offset", "my_signal", "z"),
    ),
    "geojson": (2e-4, 0, ("heading", "speed", "payload", "soc", "battery_current", "my_signal", "z")),
    "gpx": (2e-4, 0, ("heading", "speed", "payload", "soc", "battery_current", "my_signal", "z")),
    "mcap": (1e-6, 0, ("z",)),
    "sumo-fcd": (6e-4, 0, ("heading", "speed", "z")),
    "osi": (1e-9, 0, ("heading", "speed")),
    "tum": (1e-6, 0, ("heading",)),
    "kitti": (1e-6, 0, ("heading",)),
    "vda5050": (1e-9, 1000, ("heading", "speed", "payload")),  # the standard counts milliseconds
}
LOCAL = ("csv", "parquet", "geojson", "mcap", "osi", "sumo-fcd", "tum", "kitti", "vda5050")


SUFFIX = {
    "kitti": ".txt", "moving-features": ".mfjson", "open-rmf": ".yaml", "openscenario": ".xosc", "opentcs": ".xml",
    "sumo-fcd": ".fcd.xml", "sumo-net": ".net.xml", "vda5050": ".jsonl",
}  # fmt: skip
"""Of the files of a format, where it is not its name."""


def renamed(name: str, dataset: Dataset) -> dict[str, str]:
    """What a format calls the vehicles."""
    rename = {
        "sumo-fcd": lambda v: v.replace(" ", "_"), "vda5050": lambda v: f"fleetlog/{v}",
        "osi": lambda v: str(dataset.vehicles.index(v) + 1),
    }  # fmt: skip
    return {v: rename.get(name, str)(v) for v in dataset.vehicles}


def read_back(path: Path, dataset: Dataset) -> dict[str, dict[str, np.ndarray]]:
    """Rows by vehicle, sorted by time, in the site frame; channels under their own names."""
    report = ReadReport(path)
    pieces: dict[str, list[dict[str, np.ndarray]]] = {}
    for batch in detect(path).read(path, ReadOptions(report)):
        assert not batch.rejects
        for code, vehicle in enumerate(batch.vehicle.names):
            mine = batch.vehicle.codes == code
            rows = {"time": batch.time[mine]}
            for name, values in batch.columns.items():
                taken = values[mine]
                rows[name] = (
                    np.array(taken.strings(), object)
                    if isinstance(taken, Labels)
                    else np.asarray(taken, float)
                )
            if "latitude" in rows and "x" not in rows:
                assert dataset.site.frame is not None
                rows["x"], rows["y"] = dataset.site.frame.to_local(rows["latitude"], rows["longitude"])
            pieces.setdefault(vehicle if batch.has_position else f"{vehicle} channel", []).append(rows)
    assert not report.damage
    out = {}
    for vehicle, parts in pieces.items():
        names = {n for p in parts for n in p}
        joined = {
            n: np.concatenate([p.get(n, np.full(len(p["time"]), np.nan)) for p in parts]) for n in names
        }
        order = np.argsort(joined["time"], kind="stable")
        out[vehicle] = {n: v[order] for n, v in joined.items()}
    return out


def check(dataset: Dataset, path: Path, name: str, vehicles: list[str], rename=lambda v: v) -> None:
    near, late, columns = FORMATS[name]
    back = read_back(path, dataset)
    assert {rename(v) for v in vehicles} == {v for v in back if not v.endswith(" channel")}
    for vehicle in vehicles:
        t, rows = dataset.read(vehicle), back[rename(vehicle)]
        assert len(rows["time"]) == len(t)
        assert np.abs(rows["time"] - t.time).max() <= late
        for axis in ("x", "y"):
            np.testing.assert_allclose(rows[axis], t.floats(axis), rtol=0, atol=near or 1e-12)
        for column in columns:
            got, want = np.asarray(rows[column], float), t.floats(column)
            if column == "heading":
                np.testing.assert_allclose(np.cos(got - want), 1.0, atol=1e-9)
            else:
                np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-3 if near > 1e-5 else 1e-9)


@pytest.mark.parametrize("name", FORMATS)
def test_round_trip_on_earth(name: str, make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=1 if name in ("tum", "kitti") else 3)
    out = tmp_path / f"T00{SUFFIX.get(name, f'.{name}')}"
    summary = export_dataset(dataset, name, out)
    assert summary["rows"] == dataset.rows
    check(dataset, out, name, dataset.vehicles, renamed(name, dataset).get)


@pytest.mark.parametrize("name", LOCAL)
def test_round_trip_in_local_metres(name: str, make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(earth=False, vehicles=1)
    out = tmp_path / f"T00{SUFFIX.get(name, f'.{name}')}"
    export_dataset(dataset, name, out)
    if name == "mcap":  # a pose has no null: an unknown height comes back as 0
        back = read_back(out, dataset)["T00"]
        np.testing.assert_allclose(back["x"], dataset.read("T00").floats("x"), atol=1e-9)
        np.testing.assert_allclose(back["z"], np.nan_to_num(dataset.read("T00").floats("z")), atol=1e-9)
        return
    check(dataset, out, name, dataset.vehicles, renamed(name, dataset).get)


def test_a_battery_comes_back_from_vda5050(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=1)
    export_dataset(dataset, "vda5050", tmp_path / "a.jsonl")
    channel = read_back(tmp_path / "a.jsonl", dataset)["fleetlog/T00 channel"]
    t = dataset.read("T00")
    np.testing.assert_allclose(channel["soc"], t.floats("soc"), atol=1e-12)
    np.testing.assert_allclose(channel["battery_current"], t.floats("battery_current"), atol=1e-12)


def test_movingpandas_reads_moving_features(make_dataset, tmp_path: Path) -> None:
    movingpandas = pytest.importorskip("movingpandas")
    dataset = make_dataset(vehicles=2)
    export_dataset(dataset, "moving-features", tmp_path / "a.mfjson")
    found = movingpandas.read_mf_json(str(tmp_path / "a.mfjson"), traj_id_property="vehicle_id")
    assert {t.df.vehicle_id.iloc[0] for t in found.trajectories} == set(dataset.vehicles)
    assert sum(len(t.df) for t in found.trajectories) == dataset.rows
    first = found.trajectories[0].df
    latitude, longitude = dataset.site.frame.to_geographic(
        dataset.read("T00").floats("x"), dataset.read("T00").floats("y")
    )
    np.testing.assert_allclose(first.geometry.x, longitude[: len(first)], atol=2e-9)  # a feature a day
    np.testing.assert_allclose(first.geometry.y, latitude[: len(first)], atol=2e-9)


def test_evo_reads_tum(make_dataset, tmp_path: Path) -> None:
    files = pytest.importorskip("evo.tools.file_interface")
    dataset = make_dataset(vehicles=1)
    export_dataset(dataset, "tum", tmp_path / "a.tum")
    found, rows = files.read_tum_trajectory_file(tmp_path / "a.tum"), dataset.read("T00")
    assert found.check()[0]
    np.testing.assert_allclose(found.timestamps, rows.time * 1e-6, atol=1e-6)
    np.testing.assert_allclose(found.positions_xyz[:, :2].T, (rows.floats("x"), rows.floats("y")), atol=1e-6)
    yaw = 2.0 * np.arctan2(found.orientations_quat_wxyz[:, 3], found.orientations_quat_wxyz[:, 0])
    np.testing.assert_allclose(np.cos(yaw - rows.floats("heading")), 1.0, atol=1e-9)


def test_evo_reads_kitti_poses_with_their_times_as_it_reads_tum(make_dataset, tmp_path: Path) -> None:
    files = pytest.importorskip("evo.tools.file_interface")
    trajectory = pytest.importorskip("evo.core.trajectory")
    dataset = make_dataset(vehicles=1)
    export_dataset(dataset, "kitti", tmp_path / "T00.txt")
    export_dataset(dataset, "tum", tmp_path / "T00.tum")
    poses = files.read_kitti_poses_file(tmp_path / "T00.txt")
    timed = files.read_tum_trajectory_file(tmp_path / "T00.tum")
    assert poses.check()[0] and len(poses.poses_se3) == dataset.rows
    found = trajectory.PoseTrajectory3D(poses_se3=poses.poses_se3, timestamps=timed.timestamps)
    assert found.check()[0]
    np.testing.assert_allclose(np.array(found.poses_se3), np.array(timed.poses_se3), atol=1e-6)
    # and what evo writes is read back, with the times beside it
    folder = tmp_path / "kitti"
    folder.mkdir()
    files.write_kitti_poses_file(folder / "T00.txt", found)
    (tmp_path / "times.txt").rename(folder / "times.txt")
    rows, (back,) = dataset.read("T00"), read_back(folder / "T00.txt", dataset).values()
    np.testing.assert_allclose(back["time"], rows.time, atol=1)
    np.testing.assert_allclose((back["x"], back["y"]), (rows.floats("x"), rows.floats("y")), atol=1e-6)
    np.testing.assert_allclose(np.cos(back["heading"] - rows.floats("heading")), 1.0, atol=1e-9)


def test_geopandas_reads_geoparquet_with_its_reference_system(make_dataset, tmp_path: Path) -> None:
    geopandas, dataset = pytest.importorskip("geopandas"), make_dataset(vehicles=2)
    export_dataset(dataset, "parquet", tmp_path / "a.parquet")
    found = geopandas.read_parquet(tmp_path / "a.parquet")
    assert found.crs is not None and found.crs.is_geographic and found.crs.to_authority() == ("OGC", "CRS84")
    assert len(found) == dataset.rows and (found.geometry.geom_type == "Point").all()
    metres = found.to_crs("EPSG:25832").geometry
    x, y = dataset.site.frame.to_local(found.geometry.y, found.geometry.x)
    np.testing.assert_allclose((x, y), (found.x, found.y), atol=1e-6)
    gap = np.hypot(np.diff(metres.x), np.diff(metres.y))  # UTM is 0.4 m short on 1 km
    np.testing.assert_allclose(gap, np.hypot(np.diff(found.x), np.diff(found.y)), rtol=5e-4, atol=1e-6)


def test_mcap_brings_the_battery_back_as_a_channel(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=2)
    out = tmp_path / "x.mcap"
    export_dataset(dataset, "mcap", out)
    back = read_back(out, dataset)
    for vehicle in dataset.vehicles:
        t, rows = dataset.read(vehicle), back[f"{vehicle} channel"]
        for column in ("soc", "battery_voltage", "battery_current"):
            np.testing.assert_allclose(np.asarray(rows[column], float), t.floats(column), rtol=1e-12)


def test_the_library_of_mcap_reads_what_is_written(make_dataset, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    dataset = make_dataset(vehicles=2)
    out = tmp_path / "x.mcap"
    export_dataset(dataset, "mcap", out)
    with out.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        told = reader.get_summary()
        messages = [(schema.name, channel, message) for schema, channel, message in reader.iter_messages()]
    assert told.statistics.message_count == len(messages)
    places = [m for name, _, m in messages if name in ("foxglove.LocationFix", "foxglove.PoseInFrame")]
    assert len(places) == dataset.rows
    assert all(a.log_time <= b.log_time for (_, _, a), (_, _, b) in pairwise(messages))
    assert {c.message_encoding for _, c, _ in messages} == {"json"}
    assert all("timestamp" in json.loads(m.data) for _, _, m in messages[:50])


@pytest.mark.parametrize("suffix", [".csv.gz", ".csv.zst"])
def test_packed_csv_is_the_same(suffix: str, make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=2)
    out = tmp_path / f"x{suffix}"
    export_dataset(dataset, "csv", out)
    check(dataset, out, "csv", dataset.vehicles)


def test_twice_the_same_bytes(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=1, tasks=4)
    for name in base.FORMATS.names():
        for run in "ab":
            export_dataset(dataset, name, tmp_path / run / f"T00.{name}")
    files = [{p.name: p.read_bytes() for p in (tmp_path / run).iterdir()} for run in "ab"]
    assert files[0] == files[1] and "times.txt" in files[0]


def test_refusals_are_one_line_and_leave_nothing(make_dataset, tmp_path: Path) -> None:
    many, local = make_dataset(vehicles=3), make_dataset(earth=False, vehicles=1)
    out = tmp_path / "out"
    for dataset, to, options, error in (
        (many, "tum", {}, DataError), (many, "kitti", {}, DataError), (local, "gpx", {}, DataError),
        (many, "gpxx", {}, InputError), (many, "tasks", {}, DataError), (many, "csv", {"vehicles": ("T0",)}, DataError),
    ):  # fmt: skip
        with pytest.raises(error) as caught:
            export_dataset(dataset, to, out, **options)
        assert "\n" not in caught.value.line()
        assert not out.exists()
        assert not list(tmp_path.glob(".*partial*"))
    out.write_text("mine")
    with pytest.raises(OutputError):
        export_dataset(many, "csv", out)
    with pytest.raises(OutputError):
        export_dataset(many, "csv", out, overwrite=True)
    assert out.read_text() == "mine"
    out.unlink()
    export_dataset(many, "csv", out)
    export_dataset(many, "csv", out, overwrite=True)
    assert out.read_text().startswith("vehicle_id")


def test_one_vehicle_can_be_chosen(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=3)
    out = tmp_path / "T02.tum"
    assert export_dataset(dataset, "tum", out, vehicles=("T02",))["rows"] == len(dataset.read("T02"))


def test_tasks_are_the_rows_of_their_table_with_times_of_iso_8601(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=2, tasks=7)
    summary = export_dataset(dataset, "tasks", tmp_path / "tasks.csv")
    expected = pd.read_parquet(dataset.path / "tasks.parquet")
    expected["to_place"] = expected["to_place"].str.replace("=b", "'=b")  # a spreadsheet would run it
    found = pd.read_csv(tmp_path / "tasks.csv")
    assert summary["rows"] == len(found) == 7 and list(found) == list(expected)
    for name in ("earliest", "assigned", "picked", "dropped"):
        assert found[name].dropna().str.endswith("Z").all()
        found[name] = pd.to_datetime(found[name], utc=True)
    pd.testing.assert_frame_equal(found, expected, check_dtype=False)
    one = export_dataset(dataset, "tasks", tmp_path / "one.csv", vehicles=("T00",))
    assert one["rows"] == (expected.vehicle_id == "T00").sum() == 3
