"""Maps of other fleet tools: openTCS, SUMO, Open-RMF; written by hand after their schemas."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from pyproj import Geod, Transformer

from fleetlog.errors import SiteError
from fleetlog.roads import load_site

TCS = """<?xml version="1.0" encoding="UTF-8"?><model version="{version}" name="m">
<point name="A" {p}="0" {q}="0" {r}="0" type="HALT_POSITION"/><point name="B" {p}="10000" {q}="0" {r}="0" type="HALT_POSITION"/>
<point name="C" {p}="10000" {q}="5000" {r}="0" type="PARK_POSITION"/>
<path name="A-B" sourcePoint="A" destinationPoint="B" length="10000" maxVelocity="1500" maxReverseVelocity="500" locked="false"/>
<path name="B-C" sourcePoint="B" destinationPoint="C" length="5000" maxVelocity="1000" maxReverseVelocity="0" locked="false"/>
<path name="C-A" sourcePoint="C" destinationPoint="A" length="5000" maxVelocity="1000" maxReverseVelocity="0" locked="true"/>
<locationType name="t"><allowedOperation name="Load cargo"/></locationType>
<location name="L" {p}="0" {q}="1000" {r}="0" type="t"><link point="A"/></location></model>"""
NEW = {"version": "7.0.0", "p": "positionX", "q": "positionY", "r": "positionZ"}
OLD = {"version": "0.0.2", "p": "xPosition", "q": "yPosition", "r": "zPosition"}
GRAPH = """building_name: b
levels:
  L1:
    lanes:
    - [0, 1, {speed_limit: 0.5}]
    - [1, 0, {}]
    - [1, 2, {}]
    vertices:
    - [0.0, 0.0, {name: dock, is_charger: true}]
    - [10.0, 0.0, {name: ''}]
    - [10.0, 4.0, {name: p, pickup_dispenser: d}]
"""
BUILDING = """coordinate_system: reference_image
levels:
  L1:
    drawing: {filename: a.png}
    lanes:
      - [0, 1, {bidirectional: [4, true], graph_idx: [2, 0]}]
      - [1, 2, {bidirectional: [4, false], graph_idx: [2, 0]}]
    measurements:
      - [0, 1, {distance: [3, 10]}]
    vertices:
      - [0, 0, 0, dock, {is_charger: [4, true]}]
      - [200, 0, 0, ""]
      - [200, -80, 0, ""]
"""


def site(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return load_site(tmp_path / name)


@pytest.mark.parametrize("words", [NEW, OLD])
def test_an_opentcs_model_of_either_schema(tmp_path, words):
    found, reports = site(tmp_path, "model.xml", TCS.format(**words))
    n = found.roads()
    assert sorted(n.edge_ids) == ["-A-B", "A-B", "B-C"]
    assert n.length[n.edge("A-B")] == pytest.approx(10.0)
    assert n.speed_limit[n.edge("-A-B")] == pytest.approx(0.5)
    assert {(p.id, p.kind) for p in found.places} == {("L", "pick"), ("C", "park")}
    assert reports[0].dropped == {"locked": 1}


@pytest.mark.parametrize(
    ("length", "told"), [("10000", False), ("10900", False), ("15000", True), ("0", False)]
)
def test_a_length_that_is_not_the_straight_line_s_is_said(tmp_path, length, told):
    _, reports = site(
        tmp_path, "model.xml", TCS.format(**NEW).replace('length="10000"', f'length="{length}"')
    )
    assert any("off the straight line" in note for note in reports[0].notes) == told


@pytest.mark.parametrize(("name", "text"), [("0.yaml", GRAPH), ("a.building.yaml", BUILDING)])
def test_open_rmf_graphs_and_buildings_are_one_network(tmp_path, name, text):
    found, _ = site(tmp_path, name, text)
    n = found.roads()
    assert sorted(n.edge_ids) == ["-0-1", "0-1", "1-2"]
    assert n.position(np.array([n.edge("1-2")]), np.array([4.0]))[0, :2] == pytest.approx([10.0, 4.0])
    assert ("dock", "charge") in {(p.id, p.kind) for p in found.places}


WGS84 = """coordinate_system: wgs84
parameters: {generate_crs: [1, "EPSG:25832"], suggested_offset_x: [3, 510000.0], suggested_offset_y: [3, 5535000.0]}
levels:
  L1:
    lanes:
      - [0, 1, {bidirectional: [4, true], graph_idx: [2, 0]}]
      - [1, 2, {bidirectional: [4, false], graph_idx: [2, 0]}]
    vertices:
      - [9.1513, 49.9769, 0, dock, {is_charger: [4, true]}]
      - [9.1514, 49.9769, 0, ""]
      - [9.1514, 49.9770, 0, ""]
"""
METRES = """coordinate_system: cartesian_meters
levels:
  L1:
    lanes:
      - [0, 1, {bidirectional: [4, true], graph_idx: [2, 0]}]
    vertices:
      - [0, 0, 0, dock, {is_charger: [4, true]}]
      - [10, 5, 0, ""]
"""


def test_a_building_in_degrees_has_its_place_on_earth(tmp_path):
    found, _ = site(tmp_path, "a.building.yaml", WGS84)
    n = found.roads()
    assert sorted(n.edge_ids) == ["-0-1", "0-1", "1-2"]
    geod = Geod(ellps="WGS84")
    assert n.length[n.edge("0-1")] == pytest.approx(
        geod.line_length([9.1513, 9.1514], [49.9769] * 2), abs=1e-3
    )
    latitude, longitude = found.frame.to_geographic(*n.polyline(n.edge("1-2"))[-1, :2])
    assert (latitude, longitude) == pytest.approx((49.9770, 9.1514), abs=1e-8)
    (dock,) = found.places
    assert found.frame.to_geographic(dock.x, dock.y) == pytest.approx((49.9769, 9.1513), abs=1e-8)


def test_a_building_in_metres_keeps_them_y_up(tmp_path):
    found, _ = site(tmp_path, "a.building.yaml", METRES)
    assert found.frame is None and found.roads().polyline(0)[-1, :2].tolist() == [10.0, 5.0]


@pytest.mark.parametrize("inside", [True, False])
def test_metres_of_a_reference_system_have_their_place_whether_or_not_the_offset_is_in_them(tmp_path, inside):
    east, north = Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True).transform(9.1513, 49.9769)
    offset = [510000.0, 5535000.0]
    x, y = (east, north) if inside else (east - offset[0], north - offset[1])
    text = f"""building_name: b
crs_name: EPSG:25832
offset: [{offset[0]}, {offset[1]}]
levels:
  L1:
    lanes: [[0, 1, {{is_bidirectional: true}}]]
    vertices: [[{x}, {y}, {{name: dock, is_charger: true}}], [{x + 10.0}, {y}, {{name: ''}}]]
"""
    found, _ = site(tmp_path, "0.yaml", text)
    assert sorted(found.roads().edge_ids) == ["-0-1", "0-1"]
    (dock,) = found.places
    assert found.frame.to_geographic(dock.x, dock.y) == pytest.approx((49.9769, 9.1513), abs=1e-7)
    start = found.roads().polyline(found.roads().edge("0-1"))[0, :2]
    assert np.hypot(*(start - [dock.x, dock.y])) < 1e-6


UPSTAIRS = """  L2:
    fiducials: [[0, 0, lift], [0, -100, stairs]]
    lanes: [[0, 1, {}]]
    vertices: [[0, 0, 0, ""], [0, -100, 0, ""]]
"""


def test_fiducials_lay_levels_over_one_another(tmp_path):
    """The upper drawing is turned by a quarter and twice as coarse: 200 pixels below are 100 above."""
    ground = BUILDING + "    fiducials: [[0, 0, lift], [200, 0, stairs]]\n"
    n = site(tmp_path, "a.building.yaml", ground + UPSTAIRS)[0].roads()
    assert n.polyline(n.edge("L2/0-1"))[:, :2] == pytest.approx(np.array([[0, 0], [10, 0]]), abs=1e-9)
    assert n.polyline(n.edge("L1/0-1"))[:, :2] == pytest.approx(np.array([[0, 0], [10, 0]]), abs=1e-9)
    with pytest.raises(SiteError, match="level L2: has no two fiducials in common with level L1"):
        site(tmp_path, "b.building.yaml", BUILDING + UPSTAIRS)


WRONG = {
    "web_mercator": (WGS84.replace("wgs84", "web_mercator"), "coordinates of the system 'web_mercator' are not read"),
    "reference level": ("reference_level_name: L9\n" + BUILDING, "there is no level 'L9'"),
    "crs": ("crs_name: moon\n" + GRAPH, "no reference system that PROJ knows"),
    "offset": ("crs_name: EPSG:25832\noffset: 3\n" + GRAPH, "offset is not"),
    "elsewhere": (WGS84.replace("9.1514", "99.1514"), "span more than a region"),
}  # fmt: skip


@pytest.mark.parametrize("text, why", WRONG.values(), ids=WRONG)
def test_frames_of_open_rmf_that_are_not_known_are_refused_in_one_line(tmp_path, text, why):
    with pytest.raises(SiteError, match=why) as error:
        site(tmp_path, "a.building.yaml", text)
    assert "\n" not in error.value.line() and "a.building.yaml" in error.value.line()


def test_a_building_without_measurements_has_no_scale(tmp_path):
    with pytest.raises(SiteError, match="scale is unknown"):
        site(tmp_path, "a.building.yaml", BUILDING.replace("      - [0, 1, {distance: [3, 10]}]\n", ""))


@pytest.mark.parametrize(
    "text", ["levels: [", "levels: 3", "levels: {a: {lanes: [[0, 9]]}}", "levels: &a {b: *a}"]
)
def test_a_broken_graph_is_one_clear_line(tmp_path, text):
    with pytest.raises(SiteError):
        site(tmp_path, "0.yaml", text)


NET = """<net version="1.20"><location netOffset="0,0" projParameter="!"/>
<edge id="a" from="1" to="2"><lane id="a_0" index="0" speed="5" length="10" shape="0,0 10,0"/></edge>
<edge id="b" from="2" to="3"><lane id="b_0" index="0" speed="5" length="10" shape="10,0 10,10"/></edge>
<connection from="a" to="b" fromLane="0" toLane="0" dir="l" state="M"/></net>"""


def test_a_packed_network_of_sumo_is_the_unpacked_one(tmp_path):
    plain, _ = site(tmp_path, "m.net.xml", NET)
    for name in ("m.net.xml.gz", "packed.net.xml"):
        (tmp_path / name).write_bytes(gzip.compress(NET.encode()))
        packed, _ = load_site(tmp_path / name)
        assert packed.roads().edge_ids == plain.roads().edge_ids == ("a", "b")
        assert np.array_equal(packed.roads().points, plain.roads().points)


@pytest.mark.parametrize("data", [gzip.compress(NET.encode())[:-20], b"\x1f\x8b" + bytes(50), b"\x1f\x8b"])
def test_a_damaged_packed_map_is_one_clear_line(tmp_path, data):
    (tmp_path / "m.net.xml.gz").write_bytes(data)
    with pytest.raises(SiteError, match="damaged gzip file"):
        load_site(tmp_path / "m.net.xml.gz")


def test_a_packed_map_that_unpacks_without_end_is_refused(tmp_path):
    (tmp_path / "m.net.xml.gz").write_bytes(gzip.compress(NET.encode() + bytes(300 << 20), 1))
    with pytest.raises(SiteError, match="larger than 256 MB"):
        load_site(tmp_path / "m.net.xml.gz")
