"""A small dataset with every kind of column, on a site with and without a place on earth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fleetlog.core.network import Edge, build_network
from fleetlog.core.site import Frame, Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.store import Dataset, DatasetWriter

START = 1_772_431_200_000_000  # 2026-03-02T06:00:00Z


def square_site() -> Site:
    """Four roads round a 40 m square, both directions, and a one-way diagonal."""
    corners = {"a": (0.0, 0.0), "b": (40.0, 0.0), "c": (40.0, 40.0), "d": (0.0, 40.0)}

    def edge(name: str, road: str, start: str, end: str) -> Edge:
        points = np.array([[*corners[start], 0.0], [*corners[end], 0.0]])
        return Edge(name, start, end, points, road, 4.0, 3.0)

    edges = []
    for road, (start, end) in {"r1": "ab", "r2": "bc", "r3": "cd", "r4": "da"}.items():
        edges += [edge(road, road, start, end), edge(f"-{road}", road, end, start)]
    edges.append(edge("diag", "diag", "a", "c"))
    return Site("square", Frame(49.9769, 9.1513), build_network(edges))


def drive(vehicle: str, n: int, seed: int, start: int = START) -> Trajectory:
    rng = np.random.default_rng(seed)
    time = start + np.cumsum(rng.integers(90_000, 110_000, n))
    x = np.linspace(0.0, 40.0, n) + rng.normal(0, 0.01, n)
    z = np.full(n, 1.5)
    z[::7] = np.nan
    payload = np.where(np.arange(n) < n // 2, 0.0, 850.5)
    soc = np.linspace(0.9, 0.87, n)
    return Trajectory(vehicle, time, {
        "x": x, "y": rng.normal(0, 0.01, n), "z": z, "heading": rng.uniform(-3.14, 3.14, n), "speed": rng.uniform(0, 3, n),
        "edge_id": Labels(np.where(np.arange(n) % 5 == 0, -1, 0).astype(np.int32), ("r1",)),
        "edge_offset": np.clip(x, 0, 40), "trip_id": np.arange(n) // 50, "payload": payload, "soc": soc,
        "battery_voltage": np.full(n, 48.25), "battery_current": rng.normal(20, 30, n), "my_signal": rng.normal(0, 1, n),
    })  # fmt: skip


MakeDataset = Callable[..., Dataset]


@pytest.fixture
def make_dataset(tmp_path: Path) -> MakeDataset:
    def make(*, earth: bool = True, vehicles: int = 3, rows: int = 120, tasks: int = 0) -> Dataset:
        site = square_site()
        if not earth:
            site = replace(site, frame=None)
        path = tmp_path / f"data-{earth}-{vehicles}"
        with DatasetWriter.create(path, "recorded", site, overwrite=True) as writer:
            for i in range(vehicles):
                # the last one drives past midnight
                start = START + (18 * 3600 * 1_000_000 - 5_000_000 if i == vehicles - 1 else 0)
                writer.write(drive(f"T {i:02d}" if i == 1 else f"T{i:02d}", rows, i, start))
            if tasks:
                writer.tables.add("tasks", task_rows(tasks, vehicles))
        return Dataset(path)

    return make


def task_rows(count: int, vehicles: int) -> dict:
    """Tasks, the last of which nobody has taken yet and whose place to go to is open."""
    number, open_end = np.arange(count), np.arange(count) == count - 1
    time = START + number * 1_000_000
    names = Labels.of(
        [None if last else f"T{k % vehicles:02d}" for k, last in zip(number, open_end, strict=True)]
    )
    done = {
        name: np.where(open_end, -1, time + k * 500_000)
        for k, name in enumerate(("assigned", "picked", "dropped"))
    }
    return {
        "task": number, "vehicle_id": names, "from_place": Labels.of(["a"] * count), "earliest": time,
        "to_place": Labels.of([None if last else "=b" for last in open_end]), "payload": number * 100.0, **done,
        "status": Labels.of(["waiting" if last else "done" for last in open_end]),
    }  # fmt: skip
