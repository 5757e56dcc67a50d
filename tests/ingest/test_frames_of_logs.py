"""Frames of logs: alignment against known rotations and shifts, map frames, EPSG codes."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Frame, MapFrame, Site, frame_at, geographic, site_from_dict, site_to_dict
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.errors import DataError, InputError
from fleetlog.importers._profile import profile_from_dict
from fleetlog.ingest.align import align
from fleetlog.ingest.place import into_site

COURSE = [(0.0, 0.0), (70.0, 0.0), (70.0, 30.0), (40.0, 30.0), (40.0, 55.0), (0.0, 55.0), (0.0, 0.0)]


def network(corners, both: bool):
    edges = []
    for k, (a, b) in enumerate(pairwise(corners)):
        e = Edge(f"e{k}", str(a), str(b), np.array([[*a, 0.0], [*b, 0.0]]), f"e{k}")
        edges += [e, reversed_edge(e)] if both else [e]
    return build_network(edges)


def drive(corners, noise: float, seed: int) -> np.ndarray:
    points = np.array(corners)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(0.0, s[-1], 1.5)
    return np.column_stack([np.interp(at, s, v) for v in points.T]) + np.random.default_rng(seed).normal(
        0.0, noise, (len(at), 2)
    )


def seen_from(frame: MapFrame, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a log in ``frame`` says of places of the site."""
    c, s = np.cos(frame.rotation), np.sin(frame.rotation)
    x, y = (xy - np.array(frame.shift)).T
    return c * x + s * y, -s * x + c * y


@pytest.mark.parametrize("seed", range(4))
def test_a_frame_drawn_at_random_is_found(seed):
    rng = np.random.default_rng(seed)
    truth = MapFrame("t", tuple(rng.uniform(-300, 300, 2)), float(rng.uniform(-np.pi, np.pi)))
    xy = np.concatenate([drive(COURSE, 0.3, 10 * seed + k) for k in range(4)])
    found = align([seen_from(truth, xy)], network(COURSE, False))
    x, y = found.frame.to_site(*seen_from(truth, xy))
    assert np.hypot(x - xy[:, 0], y - xy[:, 1]).max() < 0.2
    assert abs(np.degrees(found.frame.rotation - truth.rotation)) < 0.2


def test_a_place_off_the_site_neither_moves_the_frame_nor_fills_memory():
    truth = MapFrame("t", (40.0, -25.0), 0.7)
    xy = np.concatenate([drive(COURSE, 0.3, k) for k in range(4)])
    x, y = seen_from(truth, xy)
    plain = align([(x, y)], network(COURSE, False)).frame
    x[len(x) // 2] = 1e9
    wild = align([(x, y)], network(COURSE, False)).frame
    assert np.hypot(*(np.array(wild.shift) - plain.shift)) < 0.05
    assert abs(wild.rotation - plain.rotation) < 1e-3


def test_a_rectangle_that_fits_either_way_round_is_refused():
    ring = [(0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0), (0.0, 0.0)]
    xy = np.concatenate([drive(ring, 0.2, k) for k in range(3)])
    with pytest.raises(DataError, match="two frames fit"):
        align([(xy[:, 0], xy[:, 1])], network(ring, False))


def test_a_single_straight_road_is_refused():
    road = [(0.0, 0.0), (200.0, 0.0)]
    xy = drive([(40.0, 0.0), (160.0, 0.0)], 0.2, 1)
    with pytest.raises(DataError, match="cannot be aligned"):
        align([(xy[:, 0], xy[:, 1])], network(road, False))


def test_a_log_of_another_place_is_refused():
    angle = np.cumsum(np.random.default_rng(3).normal(0, 0.25, 400))
    xy = np.cumsum(np.column_stack([np.cos(angle), np.sin(angle)]) * 1.5, axis=0)
    with pytest.raises(DataError, match="cannot be aligned"):
        align([(xy[:, 0], xy[:, 1])], network(COURSE, False))


def test_rows_of_a_named_map_come_into_the_site_and_others_stay():
    frame = MapFrame("hall", (10.0, -5.0), np.pi / 2, "2")
    columns = {
        "x": np.array([1.0, 1.0]), "y": np.array([2.0, 2.0]), "heading": np.array([0.0, 0.0]),
        "map_id": Labels.of(["hall", "yard"]),
    }  # fmt: skip
    rows = into_site(Trajectory("a", np.array([1, 2]), columns), [frame], None)
    assert rows.floats("x").tolist() == pytest.approx([8.0, 1.0])
    assert rows.floats("y").tolist() == pytest.approx([-4.0, 2.0])
    assert rows.floats("heading").tolist() == pytest.approx([np.pi / 2, 0.0])
    assert rows.labels("level").strings() == ["2", None]


def test_a_site_keeps_its_map_frames():
    site = Site("s", map_frames=(MapFrame("a", (1.0, 2.0), 0.5, "1"),))
    assert site_from_dict(site_to_dict(site)).map_frames == site.map_frames


def test_an_epsg_code_says_where_easting_and_northing_are():
    # UTM: the meridian of zone 32 is 9 degrees east, its false easting 500 km, its scale there 0.9996.
    _, longitude = geographic("EPSG:25832", [500_000.0], [5_500_000.0])
    assert longitude[0] == pytest.approx(9.0, abs=1e-9)
    frame = frame_at(partial(geographic, "EPSG:25832"), 500_000.0, 5_500_000.0)
    assert frame.rotation == pytest.approx(0.0, abs=1e-6)
    _, y = frame.to_local(*geographic("EPSG:25832", [500_000.0], [5_501_000.0]))
    assert float(y[0]) == pytest.approx(1000.0 / 0.9996, abs=0.01)
    assert isinstance(frame, Frame)


def test_a_code_that_does_not_exist_is_one_clear_line():
    with pytest.raises(InputError, match="EPSG:25832"):
        profile_from_dict({"crs": "EPSG:0"})
