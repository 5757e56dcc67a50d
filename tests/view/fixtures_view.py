"""A small plant and a fleet that drives round it, made here so that these tests depend on no importer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Building, Frame, Place, Site, Zone
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.store import DatasetWriter

START = int(np.datetime64("2026-03-02T06:00:00", "us").astype(np.int64))
CORNERS = {"a": (0, 0, 0), "b": (60, 0, 0), "c": (60, 40, 1.5), "d": (0, 40, 0)}


def plant(frame: bool = True, network: bool = True) -> Site:
    def line(a: str, b: str) -> Edge:
        return Edge(a + b, a, b, np.array([CORNERS[a], CORNERS[b]], float), a + b, 4.0, 4.0)

    two_way = [line("a", "b"), line("c", "d"), line("d", "a")]
    edges = [*two_way, *(reversed_edge(e) for e in two_way), line("b", "c")]
    hall = np.array([[5, 5], [30, 5], [30, 20], [20, 20], [20, 35], [5, 35]], float)
    return Site(
        "test plant",
        Frame(49.9769, 9.1513, 0.2) if frame else None,
        build_network(edges) if network else None,
        places=(
            Place("dock-1", "pick", 20, -3),
            Place("rack 7", "drop", 40, 43),
            Place("charger", "charge", -3, 20),
        ),
        zones=(Zone("slow", np.array([[50, -4], [65, -4], [65, 10], [50, 10]], float), 1.5),),
        buildings=(Building("hall", hall, 7.0),),
    )


def drive(
    site: Site, vehicle: str, shift: float, hz: float = 5.0, seconds: float = 240.0, **leave_out: bool
) -> Trajectory:
    """Round the block at up to 2 m/s, standing for 10 s in every 40, with a gap of 30 s."""
    t = np.arange(0.0, seconds, 1.0 / hz)
    speed = np.where((t % 40.0) < 30.0, 2.0, 0.0)
    s = (np.cumsum(speed) / hz + shift) % 200.0
    ring = np.array([CORNERS[c] for c in "abcda"], float)
    run = np.array([0.0, 60.0, 100.0, 160.0, 200.0])
    k = np.clip(np.searchsorted(run, s, side="right") - 1, 0, 3)
    d = np.diff(ring, axis=0)[k]
    xyz = ring[k] + ((s - run[k]) / np.diff(run)[k])[:, None] * d
    soc = 0.9 - 0.8 * t / seconds
    columns = dict(
        x=xyz[:, 0], y=xyz[:, 1], heading=np.arctan2(d[:, 1], d[:, 0]), speed=speed,
        payload=np.where((t // 60) % 2 > 0, 900.0, 0.0), fork_height=np.where((t % 40.0) > 33.0, 1.4, 0.1),
        battery_power=500.0 + 3000.0 * speed, soc=soc, trip_id=(t // 40).astype(np.int64),
    )  # fmt: skip
    if site.network is not None:
        columns["edge_id"] = Labels(k.astype(np.int32), ("ab", "bc", "cd", "da"))
        columns["edge_offset"] = s - run[k]
    time = START + np.round(t * 1e6).astype(np.int64)
    keep = (t < 150.0) | (t >= 180.0)
    return Trajectory(vehicle, time, {k: v for k, v in columns.items() if not leave_out.get(k)})[keep]


def write_fleet(path: Path, site: Site, vehicles: int = 3, **leave_out: bool) -> Path:
    with DatasetWriter.create(path, "recorded", site) as writer:
        writer.provenance = {"command": "test"}
        for i in range(vehicles):
            writer.write(drive(site, f"truck {i + 1}", 200.0 * i / vehicles, **leave_out))
    return path


def complaints(client: Any) -> list[str]:
    """What any view of a running viewer reports, and errors of its log."""
    reports = [f"{v.name}: {r.summary}" for v in client.get_state().views for r in v.reports]
    return reports + [str(line.message) for line in client.get_logs() if line.level == "ERROR"]
