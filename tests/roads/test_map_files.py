"""Every real map file: loaded with the counts that it has, or refused in one line.  The list is the folder's own."""

import numpy as np
import pytest

from fleetlog.errors import SiteError
from fleetlog.roads import load_site

# file: edges, length of all edges [m], turns
LOADED = {
    "maps/crest-curve.xodr": (2, 801, 0),
    "maps/curve_r100.xodr": (2, 1514, 0),
    "maps/curves_elevation.xodr": (2, 2312, 0),
    "maps/e6mini-lht.xodr": (6, 8787, 0),
    "maps/e6mini.xodr": (6, 8787, 0),
    "maps/fabriksgatan.xodr": (20, 1217, 24),
    "maps/malformed_declaration.xodr": (673, 7137, 751),
    "maps/parking_demo.xodr": (17, 912, 14),
    "maps/straight_500m.xodr": (2, 1000, 0),
    "maps/striaghtAndCurves.xodr": (2, 2509, 0),
    "maps/two_plus_one.xodr": (17, 1600, 12),
    "mapmatch/osmnx_drive_graph.graphml": (1028, 109460, 2365),
}
REFUSED = {
    "mapmatch/downtown_denver.geojson": "no road in it; features read: 1",
    "mapmatch/sample_trace_1.csv": "not a map of a known format",
    "mapmatch/sample_trace_2.csv": "not a map of a known format",
    "mapmatch/sample_trace_3.csv": "not a map of a known format",
    "mapmatch/test_trace.geojson": "no road in it; features read: 16",
    "mapmatch/test_trace.gpx": "not a map of a known format",
    "mapmatch/test_trace_stationary_points.geojson": "no road in it; features read: 20",
    "mapmatch/trace_bad_start.geojson": "no road in it; features read: 17",
}


def test_the_list_is_whole(shared_data):
    found = {f"{d}/{p.name}" for d in ("maps", "mapmatch") for p in (shared_data / d).iterdir()}
    assert found == LOADED.keys() | REFUSED.keys()


@pytest.mark.parametrize("name", LOADED)
def test_loaded(shared_data, name):
    site, (report,) = load_site(shared_data / name)
    network = site.roads()
    edges, length, turns = LOADED[name]
    assert (len(network), len(network.next_edges)) == (edges, turns)
    assert network.length.sum() == pytest.approx(length, abs=1.0)
    assert report.read == report.kept + sum(report.dropped.values())
    assert np.isfinite(network.points).all() and network.length.min() > 0


@pytest.mark.parametrize("name", [n for n in LOADED if n.endswith("xodr")])
def test_lanes_meet_those_that_follow_them(shared_data, name):
    network = load_site(shared_data / name)[0].roads()
    for i in range(len(network)):
        for j in network.successors(i):
            a, b = network.polyline(i), network.polyline(int(j))
            assert np.linalg.norm(a[-1] - b[0]) < 0.5
            p, q = (a[-1] - a[-2])[:2], (b[1] - b[0])[:2]
            assert p @ q > np.cos(np.radians(20)) * np.linalg.norm(p) * np.linalg.norm(q)


@pytest.mark.parametrize("name", REFUSED)
def test_refused(shared_data, name):
    with pytest.raises(SiteError) as error:
        load_site(shared_data / name)
    assert REFUSED[name] in error.value.line() and "\n" not in error.value.line()


def test_a_map_says_on_which_side_its_traffic_keeps(shared_data):
    sides = {n: load_site(shared_data / "maps" / f"{n}.xodr")[0].traffic for n in ("e6mini-lht", "e6mini")}
    assert sides == {"e6mini-lht": "left", "e6mini": "right"}


def test_the_same_motorway_right_and_left_is_the_same_lanes_driven_the_other_way(shared_data):
    right, left = (load_site(shared_data / "maps" / f"{n}.xodr")[0].roads() for n in ("e6mini", "e6mini-lht"))
    for i, name in enumerate(right.edge_ids):
        assert np.allclose(right.polyline(i), left.polyline(left.edge(name))[::-1], atol=1e-6)


@pytest.mark.parametrize("name", ["aux", "clock", "cornering", "grade", "none", "surface"])
def test_the_recorded_plants_load(shared_data, name):
    site, (report,) = load_site(shared_data / "blind" / name / "site.toml")
    assert report.read == report.kept >= 29 and site.name == "plant" and site.frame is not None
    # Whole in one piece: every junction is reached from every other.
    import networkx as nx

    network = site.roads()
    assert nx.is_strongly_connected(
        nx.DiGraph(zip(network.start.tolist(), network.end.tolist(), strict=True))
    )
