"""Recordings of large fleets, drawn together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rrd
from fixtures_view import START, drive, plant, write_fleet

from fleetlog.store import DatasetWriter
from fleetlog.view import recording, viewer


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("crowd")
    dataset = write_fleet(folder / "d", plant(), recording.MANY)
    return dataset, recording.write_recording(dataset, folder / "r.rrd")


def rows(path: Path, entity: str, component: str) -> dict[int, np.ndarray]:
    time, values = rrd.column(path, entity, component)
    return {
        (int(t) - START) // 1_000_000: np.array(v, float)
        for t, v in zip(time, values.to_pylist(), strict=True)
    }


def test_every_truck_is_drawn_at_every_second(crowd: tuple[Path, Path]) -> None:
    _, out = crowd
    where = rows(out, "/trucks/bodies", "InstancePoses3D:translations")
    assert len(where) == 240
    assert {len(where[s]) for s in (0, 100, 149, 200)} == {recording.MANY}
    assert len(where[170]) == 0, "trucks in the gap of the log"
    site = plant()
    for second in (10, 100, 200):
        truth = []
        for i in range(recording.MANY):
            t = drive(site, "v", 200.0 * i / recording.MANY)
            row = np.searchsorted(t.time, START + second * 1_000_000)
            truth.append([t.floats("x")[row], t.floats("y")[row]])
        np.testing.assert_allclose(np.sort(where[second][:, :2], axis=0), np.sort(truth, axis=0), atol=1e-4)


def test_fleet_curves(crowd: tuple[Path, Path]) -> None:
    _, out = crowd
    time, power = rrd.scalars(out, "/power/sum")
    at_10 = power[np.searchsorted(time, START + 10_000_000, side="right") - 1]
    assert at_10 == pytest.approx(recording.MANY * 6.5)
    time, lowest = rrd.scalars(out, "/soc/lowest")
    known = np.isfinite(lowest)
    np.testing.assert_allclose(
        lowest[known][:100], 90 - 80 * (time[known][:100] - START) * 1e-6 / 240, atol=0.1
    )


def test_loads_follow_the_payload(crowd: tuple[Path, Path]) -> None:
    _, out = crowd
    loads = rows(out, "/trucks/loads", "InstancePoses3D:translations")
    assert {len(loads[s]) for s in (70, 80, 119)} == {recording.MANY} and {
        len(loads[s]) for s in (10, 59, 125)
    } == {0}


def test_trucks_of_different_hours(tmp_path: Path) -> None:
    """A truck is there only while its log is."""
    site = plant(network=False)
    with DatasetWriter.create(tmp_path / "d", "recorded", site) as writer:
        for i in range(recording.MANY):
            t = drive(site, f"t{i:03d}", float(i), seconds=60.0)
            writer.write(type(t)(t.vehicle_id, t.time + (i % 2) * 3_600_000_000, t.columns))
    out = recording.write_recording(tmp_path / "d", tmp_path / "r.rrd")
    where = rows(out, "/trucks/bodies", "InstancePoses3D:translations")
    assert {len(where[s]) for s in (5, 30, 3605, 3650)} == {recording.MANY // 2} and len(where[1000]) == 0


@pytest.mark.skipif(
    viewer.vulkan_missing() is not None, reason=f"the viewer cannot draw here: {viewer.vulkan_missing()}"
)
def test_crowd_is_drawn(crowd: tuple[Path, Path]) -> None:
    from test_viewer import assert_drawn

    views = {"Site", "Plan", "Map", "Speed [m/s]", "Battery power [kW]", "State of charge [%]", "Summary"}
    assert_drawn(crowd[1], 78.0, views)
