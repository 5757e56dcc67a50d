"""Real traces and recordings of other makers: everything matched is connected, everything else has a reason."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fleetlog.core.network import Network
from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads import load_site
from fleetlog.roads.matching import REASONS, Match, match


def joined(found: Match, network: Network, most: int = 4) -> float:
    """Share of the changes of edge within a chain that a way of at most ``most`` edges or a turn in mid edge explains."""
    changes = good = 0
    for i in range(1, len(found)):
        a, b = int(found.edge[i - 1]), int(found.edge[i])
        if a < 0 or b < 0 or a == b or found.restart[i]:
            continue
        reach = {int(network.reverse[a])}
        front = {a, *(e for e in reach if e >= 0)}
        for _ in range(most):
            front = {int(j) for e in front for j in network.successors(e)}
            reach |= front
        changes += 1
        good += b in reach or int(network.reverse[b]) in reach
    return good / max(changes, 1)


@pytest.mark.parametrize("with_speed", [True, False])
@pytest.mark.parametrize("case", ["none", "clock"])
def test_a_simulated_plant(shared_data: Path, case: str, with_speed: bool) -> None:
    site, _ = load_site(shared_data / "blind" / case / "site.toml")
    table = pd.read_csv(shared_data / "blind" / case / "recorded.csv.gz")
    table = table[table.vehicle_id == table.vehicle_id.iloc[0]]
    time = pd.to_datetime(table.timestamp, format="ISO8601").dt.as_unit("us").astype("int64").to_numpy()
    assert isinstance(site.frame, Frame) and site.network is not None
    x, y = site.frame.to_local(table.latitude, table.longitude)
    columns = {"x": x, "y": y, **({"speed": table.speed.to_numpy()} if with_speed else {})}
    found = match(Trajectory("F", time, columns), site.network)
    assert (found.edge >= 0).mean() > 0.99
    assert joined(found, site.network) == 1.0
    assert np.abs(found.lateral[found.edge >= 0]).max() < 6.0
    assert (found.restart > 0).sum() <= 2


TRACES = ("test_trace", "trace_bad_start", "test_trace_stationary_points")


@pytest.mark.parametrize("name", TRACES)
def test_streets_of_denver(shared_data: Path, name: str) -> None:
    """Sparse fixes some 55 m apart, one trace with a start four kilometres off, one with standing fixes."""
    site, _ = load_site(shared_data / "mapmatch" / "osmnx_drive_graph.graphml")
    assert site.frame is not None and site.network is not None
    features = json.loads((shared_data / "mapmatch" / f"{name}.geojson").read_text())["features"]
    lonlat = np.array([f["geometry"]["coordinates"] for f in features])
    x, y = site.frame.to_local(lonlat[:, 1], lonlat[:, 0])
    found = match(Trajectory("car", np.arange(len(x)) * 10_000_000, {"x": x, "y": y}), site.network)
    off = found.edge < 0
    assert off.sum() == (1 if name == "trace_bad_start" else 0)
    assert {REASONS[r] for r in found.reason[off]} <= {"no road within reach", "position out of line"}
    assert joined(found, site.network, most=6) == 1.0
    assert np.abs(found.lateral[~off]).max() < 15.0


def test_a_trace_that_leaves_the_map(shared_data: Path) -> None:
    """Most of this drive lies outside of the graph: every row has an edge or a reason, and none is far from its edge."""
    site, _ = load_site(shared_data / "mapmatch" / "osmnx_drive_graph.graphml")
    assert site.frame is not None and site.network is not None
    table = pd.read_csv(shared_data / "mapmatch" / "sample_trace_2.csv")
    x, y = site.frame.to_local(table.latitude, table.longitude)
    found = match(Trajectory("car", np.arange(len(x)) * 1_000_000, {"x": x, "y": y}), site.network)
    on = found.edge >= 0
    assert 0.05 < on.mean() < 0.5
    assert ((found.reason > 0) == ~on).all()
    assert np.abs(found.lateral[on]).max() < 60.0
