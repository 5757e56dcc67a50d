"""A small plant and a fleet on it, made without the simulator: every truck runs along known edges at known speed."""

from pathlib import Path

import numpy as np
import pytest

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Frame, Place, Site
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids

T0 = 1_772_431_200_000_000


def grid_site(nx=4, ny=3, pitch=20.0) -> Site:
    edges = []
    for i in range(nx):
        for j in range(ny):
            for di, dj in ((1, 0), (0, 1)):
                if i + di < nx and j + dj < ny:
                    p = np.array([[i * pitch, j * pitch, 0], [(i + di) * pitch, (j + dj) * pitch, 0.0]])
                    e = Edge(
                        f"e{i}{j}{'x' if di else 'y'}",
                        f"n{i}{j}",
                        f"n{i + di}{j + dj}",
                        p,
                        f"e{i}{j}{'x' if di else 'y'}",
                        3.0,
                        4.0,
                    )
                    edges += [e, reversed_edge(e)]
    return Site(
        "grid", Frame(50.0, 9.0), build_network(edges), places=(Place("charger-1", "charge", 0.0, 0.0),)
    )


def walk(network, seed, seconds, dt=1.0) -> Trajectory:
    """Drives at 2 m/s over random turns and stands 40 s now and then."""
    rng = np.random.default_rng(seed)
    edge, s, stand, rows = int(rng.integers(len(network))), 0.0, 0.0, []
    for k in range(int(seconds / dt)):
        v = 0.0
        if stand > 0:
            stand -= dt
        else:
            v = 2.0 if (k * dt) % 90 > 25 else 0.6
            s += v * dt
            if s > network.length[edge]:
                s -= network.length[edge]
                edge = int(rng.choice(network.successors(edge)))
                stand = 80.0 if rng.random() < 0.12 else 0.0
        rows.append((k * dt, edge, s, v))
    t, e, o, v = (np.array(c) for c in zip(*rows, strict=True))
    xy = network.position(e.astype(np.int32), o)
    out = Trajectory(
        f"T{seed}", T0 + np.round(t * 1e6).astype(np.int64),
        {
            "x": xy[:, 0], "y": xy[:, 1], "speed": v, "edge_id": Labels(e.astype(np.int32), network.edge_ids), "edge_offset": o,
            "soc": np.linspace(0.6, 0.3, len(t)), "battery_power": 400 + 1500 * v, "payload": np.where((t // 300) % 2 == 0, 0.0, 900.0),
        },
    )  # fmt: skip
    return out.with_columns(trip_id=trip_ids(out))


@pytest.fixture(scope="session")
def fleet(tmp_path_factory) -> Dataset:
    return write(tmp_path_factory.mktemp("fleet") / "d", range(6), 1800)


def write(path: Path, seeds, seconds, dt=1.0, site=None) -> Dataset:
    site = site or grid_site()
    with DatasetWriter.create(path, "recorded", site) as w:
        for seed in seeds:
            w.write(walk(site.roads(), seed, seconds, dt))
    return Dataset(path)
