"""GeoJSON roads: ids, directions, nodes, heights, and what is refused."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.site import Frame
from fleetlog.errors import SiteError
from fleetlog.roads import load_site

FRAME = Frame(49.97, 9.15)


def line(name, *points, **properties):
    """A road through points in metres about FRAME; a third number is the height."""
    coordinates = []
    for p in points:
        latitude, longitude = FRAME.to_geographic(p[0], p[1])
        coordinates.append([float(longitude), float(latitude), *p[2:]])
    geometry = {"type": "LineString", "coordinates": coordinates}
    return {"type": "Feature", "properties": {"id": name, **properties}, "geometry": geometry}


@pytest.fixture
def load(tmp_path):
    def loaded(*features):
        path = tmp_path / "roads.geojson"
        path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
        site, (report,) = load_site(path)
        return site.roads(), report

    return loaded


def turns(network):
    return {
        (network.edge_ids[i], network.edge_ids[j]) for i in range(len(network)) for j in network.successors(i)
    }


def test_two_way_roads_have_two_edges_and_one_way_roads_one(load):
    network, report = load(
        line("a", (0, 0), (50, 0), **{"from": "n1", "to": "n2", "speed_limit": 4.5, "width": 3.0}),
        line("b", (50, 0), (90, 0), **{"from": "n2", "to": "n3", "oneway": True}),
    )
    assert network.edge_ids == ("a", "-a", "b")
    assert network.roads == ("a", "a", "b") and list(network.reverse) == [1, 0, -1]
    assert turns(network) == {("a", "b"), ("-a", "a")}
    assert list(network.speed_limit[:2]) == [4.5, 4.5] and np.isnan(network.width[2])
    assert network.length == pytest.approx([50, 50, 40], abs=1e-3)
    assert (report.read, report.kept, report.dropped) == (2, 2, {})


#      c
#      |
#  a---+---b      three roads that name no nodes
def test_ends_that_coincide_are_one_node(load):
    network, _ = load(
        line("a", (0, 0), (50, 0)), line("b", (50.03, 0), (90, 0)), line("c", (50, 0.02), (50, 40))
    )
    assert {("a", "b"), ("a", "c"), ("-b", "-a"), ("-b", "c"), ("-c", "b"), ("-c", "-a")} <= turns(network)


def test_ends_a_metre_apart_are_not_joined(load):
    network, _ = load(line("a", (0, 0), (50, 0)), line("b", (51, 0), (90, 0)))
    assert turns(network) == {("a", "-a"), ("-a", "a"), ("b", "-b"), ("-b", "b")}


#         c
#         |
#  a------+------    the road a has a vertex where c ends
def test_a_road_is_split_where_another_has_a_vertex_on_one_of_its_own(load):
    network, report = load(line("a", (0, 0), (50, 0), (90, 0)), line("c", (50, 0), (50, 40)))
    assert set(network.roads) == {"a:0", "a:1", "c"}
    assert {("a:0", "a:1"), ("a:0", "c"), ("-c", "a:1"), ("-c", "-a:0")} <= turns(network)
    assert any("split" in note for note in report.notes)


def test_roads_that_cross_without_a_vertex_or_on_another_level_stay_apart(load):
    network, _ = load(line("a", (0, 0), (100, 0)), line("b", (50, -40), (50, 40)))
    assert set(network.roads) == {"a", "b"}
    network, _ = load(
        line("a", (0, 0, 0), (50, 0, 0), (90, 0, 0)), line("b", (50, -40, 6), (50, 0, 6), (50, 40, 6))
    )
    assert set(network.roads) == {"a", "b"}


def test_roads_that_name_their_nodes_are_never_split(load):
    named = {"from": "1", "to": "2"}, {"from": "3", "to": "4"}
    network, _ = load(
        line("a", (0, 0), (50, 0), (90, 0), **named[0]), line("c", (50, 0), (50, 40), **named[1])
    )
    assert set(network.roads) == {"a", "c"}


def test_a_densely_drawn_road_keeps_all_its_vertices(load):
    network, _ = load(line("a", *[(0.05 * k, 0) for k in range(201)]))
    assert network.length[0] == pytest.approx(10.0, abs=1e-3) and len(network.node_ids) == 2


def test_heights_count_when_every_vertex_has_one(load):
    climb = line("a", (0, 0, 10.0), (40, 0, 12.0))
    network, _ = load(climb)
    assert network.has_elevation and network.length[0] == pytest.approx(np.hypot(40, 2), abs=1e-3)
    assert network.slope(np.array([0, 1], np.int32), np.zeros(2)) == pytest.approx([0.05, -0.05], abs=1e-4)
    network, report = load(climb, line("b", (40, 0), (80, 0)))
    assert not network.has_elevation and any("no heights" in note for note in report.notes)
    assert not network.points[:, 2].any()


def test_every_feature_is_accounted_for(load):
    point = {
        "type": "Feature",
        "properties": {"id": "p"},
        "geometry": {"type": "Point", "coordinates": [9.15, 49.97]},
    }
    empty = {"type": "Feature", "properties": {"id": "e"}, "geometry": None}
    spot = line("s", (0, 0), (0, 0))
    nameless = line(None, (0, 0), (9, 0), one_way=True)
    network, report = load(point, empty, spot, nameless, line("r", (9, 0), (20, 0)))
    assert (report.read, report.kept, report.dropped) == (5, 2, {"not a line": 2, "without length": 1})
    assert network.edge_ids[0] == "road3"
    assert any("did you mean 'oneway'" in note for note in report.notes)
    assert any("1 road without an id" in note for note in report.notes)


def test_the_parts_of_a_multilinestring_are_roads(load):
    both = line("m", (0, 0), (9, 0))
    other = line("", (9, 0), (9, 9))["geometry"]["coordinates"]
    both["geometry"] = {"type": "MultiLineString", "coordinates": [both["geometry"]["coordinates"], other]}
    network, _ = load(both)
    assert set(network.roads) == {"m:part0", "m:part1"}


WRONG = [
    ({"properties": {"id": "r", "oneway": "perhaps"}}, "oneway is 'perhaps'"),
    ({"properties": {"id": "r", "speed_limit": -3}}, "speed_limit: -3 is not above zero"),
    ({"properties": {"id": "r", "width": "wide"}}, "'wide' is not a number"),
    ({"properties": []}, None),
    ({"properties": [1]}, "properties are not an object"),
    (
        {"geometry": {"type": "LineString", "coordinates": [[512000, 5530000], [512010, 5530000]]}},
        "not longitude",
    ),
    ({"geometry": {"type": "LineString", "coordinates": [[9, 49], [9]]}}, "is not a position"),
    ({"geometry": {"type": "LineString", "coordinates": [[9, 49], [9, None]]}}, "is not a number"),
    ({"geometry": {"type": "LineString", "coordinates": "far"}}, "is not a position"),
    ({"geometry": [1]}, "is not a feature"),
]


@pytest.mark.parametrize("change, why", WRONG)
def test_refused_in_one_line(load, change, why):
    feature = {**line("r", (0, 0), (9, 0)), **change}
    if why is None:
        assert len(load(feature)[0]) == 2
        return
    with pytest.raises(SiteError, match=why) as error:
        load(feature)
    assert "feature 0" in error.value.line() and "\n" not in error.value.line()


def test_wrong_documents(tmp_path):
    path = tmp_path / "roads.geojson"
    for text, why in [
        ('{"type": "FeatureCollection"', "not valid JSON"),
        ('{"type": "FeatureCollection", "features": [' + "[" * 100_000, "not readable|not valid"),
        ('{"type": "Feature"s}', "not valid JSON"),
        ('{"type": "FeatureCollection", "features": 3}', "not a FeatureCollection"),
        ('{"type": "FeatureCollection", "features": []}', "no road in it; features read: 0"),
        ('{"type": "FeatureCollection", "features": [], "crs": {"properties": {"name": "EPSG:25832"}}}', "coordinates are in EPSG:25832"),
    ]:  # fmt: skip
        path.write_text(text)
        with pytest.raises(SiteError, match=why):
            load_site(path)
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [line("r", (0, 0), (9, 0))] * 2}))
    with pytest.raises(SiteError, match="two roads share the id 'r'"):
        load_site(path)


@given(st.lists(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=2, max_size=8, unique=True))
@settings(deadline=None, max_examples=40)
def test_degrees_come_back_as_the_metres_that_they_were(tmp_path_factory, points):
    path = tmp_path_factory.mktemp("g") / "roads.geojson"
    spots = [(3.0 * x, 3.0 * y) for x, y in points]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [line("r", *spots)]}))
    (path.parent / "site.toml").write_text(
        f'[frame]\nlatitude = {FRAME.latitude}\nlongitude = {FRAME.longitude}\n[network]\nfile = "roads.geojson"\n'
    )
    network = load_site(path.parent)[0].roads()
    assert np.allclose(network.polyline(0)[:, :2], spots, atol=1e-6)
    assert np.allclose(network.polyline(1), network.polyline(0)[::-1])
