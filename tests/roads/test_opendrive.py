"""OpenDRIVE: connectivity, traffic sides, lane widths, speeds, places on earth, and what is refused."""

import math

import numpy as np
import pytest
from pyproj import Transformer
from xodr_maps import document, geometry, lane, link, road, section

from fleetlog.errors import SiteError
from fleetlog.roads import load_site
from fleetlog.roads.formats.base import MapOptions
from fleetlog.roads.load import read_map

RULES = ['rule="RHT"', 'rule="LHT"']


@pytest.fixture
def write(tmp_path):
    def written(*parts, header="", name="map.xodr"):
        path = tmp_path / name
        path.write_text(document(*parts, header=header))
        return path

    return written


def edges_of(path, options=None):
    found = read_map(path, options or MapOptions())
    return {e.id: e for e in found.edges}, set(found.turns), found


def straight(id, x, length, *sections, **more):
    return road(id, length, geometry(0, x, 0, 0, length), *sections, **more)


@pytest.mark.parametrize("rule, forward", [('rule="RHT"', -1), ('rule="LHT"', 1), ("", -1)])
def test_the_side_of_traffic_decides_the_direction(write, rule, forward):
    edges, _, _ = edges_of(write(straight("1", 0, 50, section(0, lane(1), lane(-1)), rule=rule)))
    assert edges[f"1:0:{forward}"].points[-1, 0] == pytest.approx(50, abs=1e-6)
    assert edges[f"1:0:{-forward}"].points[-1, 0] == pytest.approx(0, abs=1e-6)
    # id > 0 is left of the reference line whatever the rule
    assert edges["1:0:1"].points[0, 1] == pytest.approx(1.5)


def test_a_map_without_a_rule_takes_the_side_that_the_site_says(write):
    path = write(straight("1", 0, 50, section(0, lane(-1)), rule=""))
    edges, _, _ = edges_of(path, MapOptions(traffic="left"))
    assert edges["1:0:-1"].points[0, 0] == pytest.approx(50, abs=1e-6)


def two_roads(meeting, links=(True, True), rule='rule="RHT"'):
    """Two roads of 50 m in line; the second's s runs with the first's ("start") or head to head ("end")."""
    same = meeting == "start"
    other = (1, -1) if same else (-1, 1)
    a = [lane(1, after=other[0] if links[0] else None), lane(-1, after=other[1] if links[0] else None)]
    key = "before" if same else "after"
    b = [lane(i, **{key: (i if same else -i) if links[1] else None}) for i in (1, -1)]
    first = straight("1", 0, 50, section(0, *a), after=link("successor", "road", 2, meeting), rule=rule)
    if same:
        second = straight(
            "2", 50, 50, section(0, *b), before=link("predecessor", "road", 1, "end"), rule=rule
        )
    else:
        geo = geometry(0, 100, 0, math.pi, 50)
        second = road("2", 50, geo, section(0, *b), after=link("successor", "road", 1, "end"), rule=rule)
    return first, second


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("meeting", ["start", "end"])
@pytest.mark.parametrize("links", [(True, True), (True, False), (False, True)])
def test_roads_in_line_join_whichever_way_their_s_runs_and_whoever_says_so(write, meeting, links, rule):
    edges, turns, found = edges_of(write(*two_roads(meeting, links, rule)))
    forward = 1 if "LHT" in rule else -1
    ahead = forward if meeting == "start" else -forward
    assert turns == {(f"1:0:{forward}", f"2:0:{ahead}"), (f"2:0:{-ahead}", f"1:0:{-forward}")}
    for a, b in turns:
        assert np.linalg.norm(edges[a].points[-1] - edges[b].points[0]) < 1e-5
    said = any("one direction only" in note for note in found.report.notes)
    assert said == (links != (True, True))


@pytest.mark.parametrize("meeting", ["start", "end"])
def test_a_link_without_a_contact_point_meets_the_nearer_end(write, meeting):
    first, second = (
        part.replace(' contactPoint="start"', "").replace(' contactPoint="end"', "")
        for part in two_roads(meeting)
    )
    _, turns, _ = edges_of(write(first, second))
    assert turns == edges_of(write(*two_roads(meeting)))[1]


def test_links_to_what_is_not_there_are_told_of(write):
    nowhere = link("successor", "road", 99, "start")
    _, turns, found = edges_of(
        write(
            straight("1", 0, 50, section(0, lane(-1, after=-1)), after=nowhere),
            straight("2", 0, 50, section(0, lane(-1, after=-7)), after=link("successor", "road", 1, "end")),
            '<junction id="5"><connection id="0" incomingRoad="1" connectingRoad="98" contactPoint="start"/></junction>',
        )
    )
    assert turns == set()
    assert any(
        note.startswith("3 links left out, to roads or lanes that do not exist")
        for note in found.report.notes
    )


def junction_map(rule='rule="RHT"', in_road=True):
    """Road 1 meets road 2 straight on (connecting road 9) in junction 5."""
    toward = link("predecessor", "road", 1, "end") if in_road else ""
    onward = link("successor", "road", 2, "start")
    return (
        straight("1", 0, 50, section(0, lane(1), lane(-1)), after=link("successor", "junction", 5), rule=rule),
        straight("2", 60, 40, section(0, lane(1), lane(-1)), before=link("predecessor", "junction", 5), rule=rule),
        straight(
            "9", 50, 10, section(0, lane(1, 1 if in_road else None, 1), lane(-1, -1 if in_road else None, -1)),
            before=toward, after=onward, junction=5, rule=rule,
        ),
        '<junction id="5"><connection id="0" incomingRoad="1" connectingRoad="9" contactPoint="start">'
        '<laneLink from="1" to="1"/><laneLink from="-1" to="-1"/></connection></junction>',
    )  # fmt: skip


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("in_road", [True, False])
def test_junctions_join_by_their_own_links_or_the_connecting_roads(write, rule, in_road):
    _, turns, _ = edges_of(write(*junction_map(rule, in_road=in_road)))
    forward = 1 if "LHT" in rule else -1
    chain = {(f"1:0:{forward}", f"9:0:{forward}"), (f"9:0:{forward}", f"2:0:{forward}")}
    back = {(f"2:0:{-forward}", f"9:0:{-forward}"), (f"9:0:{-forward}", f"1:0:{-forward}")}
    assert turns == chain | back


def test_a_junction_at_both_ends_of_a_road_is_told_apart_by_nearness(write):
    both = link("predecessor", "junction", 5) + link("successor", "junction", 5)
    ring = road("1", 50, geometry(0, 0, 0, 0, 50), section(0, lane(-1)), before=both)
    on = straight(
        "9", 50, 10, section(0, lane(-1, -1)), before=link("predecessor", "road", 1, "end"), junction=5
    )
    to = '<junction id="5"><connection id="0" incomingRoad="1" connectingRoad="9" contactPoint="start"><laneLink from="-1" to="-1"/>'
    _, turns, _ = edges_of(write(ring, on, to + "</connection></junction>"))
    assert turns == {("1:0:-1", "9:0:-1")}


def test_direct_junctions_join_and_virtual_ones_do_not(write):
    first = straight("1", 0, 50, section(0, lane(-1)), after=link("successor", "junction", 5))
    second = straight("2", 50, 50, section(0, lane(-1)), before=link("predecessor", "junction", 5))
    direct = (
        '<junction id="5" type="{}"><connection id="0" incomingRoad="1" linkedRoad="2" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection></junction>'
    )
    _, turns, _ = edges_of(write(first, second, direct.format("direct")))
    assert turns == {("1:0:-1", "2:0:-1")}
    _, turns, found = edges_of(write(first, second, direct.format("virtual")))
    assert turns == set() and any("virtual" in note for note in found.report.notes)


def test_lane_sections_shorter_than_a_millimetre_are_passed_through(write):
    sections = (
        section(0, lane(-1, after=-1)), section(20, lane(-1, -1, -1)), section(20.0005, lane(-1, -1))
    )  # fmt: skip
    edges, turns, found = edges_of(write(straight("1", 0, 50, *sections)))
    assert turns == {("1:0:-1", "1:2:-1")} and set(edges) == {"1:0:-1", "1:2:-1"}
    assert found.report.dropped == {"shorter than 1 mm": 1}


DIRECTIONS = [
    ('direction="standard"', "", "driving", [50]),
    ('direction="reversed"', "", "driving", [0]),
    ('direction="both"', "", "driving", [50, 0]),
    ("", "", "bidirectional", [50, 0]),
    ("", '<userData><vectorLane travelDir="backward"/></userData>', "driving", [0]),
    ("", '<userData><vectorLane travelDir="bidirectional"/></userData>', "driving", [50, 0]),
]


@pytest.mark.parametrize("more, inside, type, ends", DIRECTIONS)
def test_lane_directions(write, more, inside, type, ends):
    edges, _, _ = edges_of(
        write(straight("1", 0, 50, section(0, lane(-1, more=more, inside=inside, type=type))))
    )
    assert [round(float(e.points[-1, 0])) for e in edges.values()] == ends
    assert list(edges) == ["1:0:-1", "-1:0:-1"][: len(ends)]


def test_both_directions_of_a_lane_are_each_others_reverse(write):
    site, _ = load_site(write(straight("1", 0, 50, section(0, lane(-1, type="bidirectional")))))
    network = site.roads()
    assert list(network.reverse) == [1, 0] and network.roads == ("1:0:-1",) * 2


def test_length_follows_the_lane_and_not_the_reference_line(write):
    # Left curve of radius 10 m: 0.825 and 1.175 times as long at 1.75 m to the left and right.
    length = 10 * math.pi / 2
    arc = road(
        "1",
        length,
        geometry(0, 0, 0, 0, length, '<arc curvature="0.1"/>'),
        section(0, lane(1, width=3.5), lane(-1, width=3.5)),
    )
    network = load_site(write(arc))[0].roads()
    share = dict(zip(network.edge_ids, network.length / length, strict=True))
    assert share["1:0:1"] == pytest.approx(0.825, abs=1e-3)
    assert share["1:0:-1"] == pytest.approx(1.175, abs=1e-3)


def test_lane_offset_and_all_width_records_count(write):
    widening = '<width sOffset="20" a="3" b="0.1" c="0" d="0"/>'
    shifted = straight(
        "1", 0, 40, section(0, lane(-1, inside=widening)), lanes='<laneOffset s="0" a="1" b="0" c="0" d="0"/>'
    )
    points = edges_of(write(shifted))[0]["1:0:-1"].points
    assert np.interp([10, 20, 40], points[:, 0], points[:, 1]) == pytest.approx([-0.5, -0.5, -1.5], abs=1e-5)


def test_borders_do_for_widths(write):
    def bordered(i, a):
        return i, f'<lane id="{i}" type="driving"><border sOffset="0" a="{a}" b="0" c="0" d="0"/></lane>'

    edges, _, _ = edges_of(write(straight("1", 0, 40, section(0, bordered(-1, -3), bordered(-2, -7)))))
    assert edges["1:0:-1"].points[0, 1] == pytest.approx(-1.5) and edges["1:0:-1"].width == pytest.approx(3)
    assert edges["1:0:-2"].points[0, 1] == pytest.approx(-5.0) and edges["1:0:-2"].width == pytest.approx(4)


SPEEDS = [("30", 'unit="mph"', 13.4112), ("36", 'unit="km/h"', 10.0), ("8", "", 8.0), ("8", 'unit="m/s"', 8.0), ("no limit", "", None), ("undefined", "", None)]  # fmt: skip


@pytest.mark.parametrize("value, unit, expected", SPEEDS)
@pytest.mark.parametrize("of_lane", [True, False])
def test_speed_units(write, value, unit, expected, of_lane):
    limit = f'<speed {"sOffset=%s0%s" % ((chr(34),) * 2) if of_lane else ""} max="{value}" {unit}/>'
    inner, outer = (limit, "") if of_lane else ("", f'<type s="0" type="town">{limit}</type>')
    edges, _, _ = edges_of(write(straight("1", 0, 40, section(0, lane(-1, inside=inner)), inside=outer)))
    found = edges["1:0:-1"].speed_limit
    assert math.isnan(found) if expected is None else found == pytest.approx(expected)


def test_elevation_is_that_of_the_lane(write):
    profile = '<elevationProfile><elevation s="0" a="1" b="0.05" c="0" d="0"/></elevationProfile>'
    site, _ = load_site(write(straight("1", 0, 40, section(0, lane(1), lane(-1)), inside=profile)))
    network = site.roads()
    assert network.has_elevation
    slope = network.slope(np.array([0, 1], np.int32), np.array([10.0, 10.0]))
    assert sorted(np.tan(slope)) == pytest.approx([-0.05, 0.05], abs=1e-9)
    assert not load_site(write(straight("1", 0, 40, section(0, lane(-1)))))[0].roads().has_elevation


def test_lane_types_are_a_choice_and_the_rest_is_counted(write, tmp_path):
    path = write(
        straight("1", 0, 40, section(0, lane(-1), lane(-2, type="restricted"), lane(-3, type="sidewalk")))
    )
    _, (report,) = load_site(path)
    assert (report.read, report.kept) == (3, 1)
    assert report.dropped == {"lane type restricted": 1, "lane type sidewalk": 1}
    assert any("restricted 40 m, sidewalk 40 m" in note for note in report.notes)
    (tmp_path / "site.toml").write_text('[network]\nfile = "map.xodr"\nlane_types = ["restricted"]\n')
    assert load_site(tmp_path / "site.toml")[0].roads().edge_ids == ("1:0:-2",)


def curvy(x=0.0, y=0.0, turn=0.0, rule='rule="RHT"', mirror=1):
    """A road of spiral and arc somewhere; ``mirror`` -1 draws it reflected in the x axis, before it is moved and turned."""
    curve = f'<spiral curvStart="0" curvEnd="{mirror * 0.05}"/>'
    lanes = [lane(i, after=None, width=3 + 0.2 * abs(i)) for i in (2, 1, -1, -2)]
    return road("1", 30, geometry(0, x, y, turn, 30, curve), section(0, *lanes), rule=rule)


def test_moving_and_turning_a_map_moves_and_turns_its_lanes(write):
    here = edges_of(write(curvy()))[0]
    there = edges_of(write(curvy(100, -20, 0.7)))[0]
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for name, edge in here.items():
        assert np.allclose(edge.points @ turn.T + [100, -20, 0], there[name].points, atol=1e-9)


def test_drawing_a_road_against_its_direction_changes_no_lane(write):
    """The same road with s from the other end: lane ids change sign, places and directions of travel stay."""
    arc, bend = 20.0, 0.05
    here = road(
        "1",
        arc,
        geometry(0, 0, 0, 0, arc, f'<arc curvature="{bend}"/>'),
        section(0, lane(1, width=3), lane(-1, width=4)),
    )
    x, y = math.sin(bend * arc) / bend, (1 - math.cos(bend * arc)) / bend
    back = geometry(0, x, y, bend * arc + math.pi, arc, f'<arc curvature="{-bend}"/>')
    there = road("1", arc, back, section(0, lane(1, width=4), lane(-1, width=3)))
    first, second = edges_of(write(here))[0], edges_of(write(there))[0]
    for i in (1, -1):
        assert np.allclose(first[f"1:0:{i}"].points, second[f"1:0:{-i}"].points, atol=1e-6)


def test_left_hand_traffic_is_right_hand_traffic_in_a_mirror(write):
    right = edges_of(write(curvy()))[0]
    left = edges_of(write(curvy(rule='rule="LHT"', mirror=-1)))[0]
    for name, edge in right.items():
        road_id, k, i = name.split(":")
        twin = left[f"{road_id}:{k}:{-int(i)}"]
        assert np.allclose(edge.points * [1, -1, 1], twin.points, atol=1e-9)


PROJ = "+proj=tmerc +lat_0=49.9 +lon_0=9.1 +k=1 +x_0=0 +y_0=0 +datum=WGS84"


def located(text, offset=""):
    return f"<geoReference><![CDATA[{text}]]></geoReference>{offset}"


def test_a_geo_reference_becomes_the_frame_and_leaves_coordinates_alone(write):
    site, _ = load_site(write(curvy(), header=located(PROJ)))
    assert (site.frame.latitude, site.frame.longitude) == pytest.approx((49.9, 9.1), abs=1e-9)
    assert np.allclose(site.roads().polyline(0), edges_of(write(curvy()))[0][site.roads().edge_ids[0]].points)


@pytest.mark.parametrize("text", [PROJ, "+proj=utm +zone=32 +datum=WGS84", "EPSG:25832"])
@pytest.mark.parametrize("heading", [0.0, 0.4])
def test_the_frame_agrees_with_the_projection_offset_added(write, text, heading):
    x_off, y_off = (0, 0) if "tmerc" in text else (507000, 5530000)
    header = located(text, f'<offset x="{x_off}" y="{y_off}" z="0" hdg="{heading}"/>')
    site, _ = load_site(write(straight("1", 100, 50, section(0, lane(-1))), header=header))
    point = site.roads().polyline(0)[-1]
    latitude, longitude = site.frame.to_geographic(point[0], point[1])
    x, y = 150.0, -1.5
    grid = (
        x * math.cos(heading) - y * math.sin(heading) + x_off,
        x * math.sin(heading) + y * math.cos(heading) + y_off,
    )
    expected = Transformer.from_crs(text, "EPSG:4326", always_xy=True).transform(*grid)
    assert (float(longitude), float(latitude)) == pytest.approx(expected, abs=1e-8)


def test_a_utm_grid_is_brought_to_true_metres(write):
    # A grid line east of the central meridian: 0.9996 metres of grid a metre, so 1000 m of grid are 1000.4 m of ground.
    header = located("+proj=utm +zone=32 +datum=WGS84", '<offset x="500000" y="5530000"/>')
    site, (report,) = load_site(write(straight("1", 0, 1000, section(0, lane(-1))), header=header))
    assert site.roads().length[0] == pytest.approx(1000 / 0.9996, abs=0.01)
    assert any("projection" in note for note in report.notes)


NOWHERE = [
    ("", "no geoReference"),
    (located("+proj=utm +zone=32 +lon_0=-122 +datum=WGS84"), "contradicts itself"),
    (located("+proj=longlat +datum=WGS84"), "no projection to metres"),
    (located("somewhere nice"), "not understood"),
]


@pytest.mark.parametrize("header, why", NOWHERE)
def test_without_a_place_on_earth_there_is_no_frame_and_it_is_said(write, header, why):
    site, (report,) = load_site(write(curvy(), header=header))
    assert site.frame is None
    assert any(why in note for note in report.notes)


LAUGHS = '<!DOCTYPE l [<!ENTITY a "ha">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True)
)

REFUSED = {
    "not closed": ("<OpenDRIVE><road>", "not well-formed"),
    "other root": ("<svg/>", "root is <svg>"),
    "no road": ("<OpenDRIVE></OpenDRIVE>", "no driven lane"),
    "text for a number": (document(straight("1", 0, "long", section(0, lane(-1)))), "'long' is not a number"),
    "infinite": (document(road("1", 5, geometry(0, "inf", 0, 0, 5), section(0, lane(-1)))), "not a finite number"),
    "negative length": (document(road("1", -5, geometry(0, 0, 0, 0, 5), section(0, lane(-1)))), "length is -5 m"),
    "absurd length": (document(straight("1", 0, 1e8, section(0, lane(-1)))), "length is 1e+08 m"),
    "absurd curvature": (
        document(road("1", 50, geometry(0, 0, 0, 0, 50, '<arc curvature="1e9"/>'), section(0, lane(-1)))),
        "curvature 1e+09",
    ),
    "no shape": (document(road("1", 5, geometry(0, 0, 0, 0, 5, ""), section(0, lane(-1)))), "no known shape"),
    "lane gap": (document(straight("1", 0, 5, section(0, lane(-1), lane(-3)))), "do not count up"),
    "a lane far out": (document(straight("1", 0, 5, section(0, lane(-1), lane(-1000000000)))), "do not count up"),
    "a lane far in": (document(straight("1", 0, 5, section(0, lane(1000000000)))), "do not count up"),
    "a thousand lanes": (document(straight("1", 0, 5, section(0, *(lane(-k) for k in range(1, 1000))))), "1,000 lanes"),
    "rule": (document(straight("1", 0, 5, section(0, lane(-1)), rule='rule="UK"')), "rule is 'UK'"),
    "twice": (document(*[straight("1", 0, 5, section(0, lane(-1)))] * 2), "two roads have the id '1'"),
    "laughs": (LAUGHS + "]><OpenDRIVE>&j;</OpenDRIVE>", "entities"),
    "laughs in an attribute": (LAUGHS + ']><OpenDRIVE a="&j;"/>', "entities"),
    "external": ('<!DOCTYPE l [<!ENTITY x SYSTEM "file:///etc/hostname">]><OpenDRIVE>&x;</OpenDRIVE>', "entities"),
    "external declarations": ('<!DOCTYPE OpenDRIVE SYSTEM "map.dtd"><OpenDRIVE/>', "DOCTYPE"),
}  # fmt: skip


@pytest.mark.parametrize("text, why", REFUSED.values(), ids=REFUSED)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_refused_in_one_line(tmp_path, text, why, encoding):
    path = tmp_path / "map.xodr"
    path.write_bytes(text.replace('<?xml version="1.0"?>', "").encode(encoding))
    with pytest.raises(SiteError) as error:
        load_site(path)
    line = error.value.line()
    assert "\n" not in line and "map.xodr" in line and len(line) < 300
    assert why in line or (encoding == "utf-16" and "DOCTYPE" in line) or "entit" in line.lower()


def test_many_lanes_of_a_long_road_do_not_fill_memory(write, monkeypatch):
    monkeypatch.setattr("fleetlog.roads.formats.base.MOST_VERTICES", 5000)
    path = write(straight("1", 0, 1e5, section(0, lane(-1), lane(-2))))
    with pytest.raises(SiteError, match="needs more than 5,000 vertices"):
        load_site(path)


def test_the_sample_plant_has_the_same_roads_as_its_geojson(project_root):
    drawn = load_site(project_root / "sample_data" / "site.toml")[0].roads()
    lanes = load_site(project_root / "sample_data" / "site_3d.toml")[0].roads()
    # Every lane runs beside a road of the GeoJSON map, which is drawn along the middle.
    from fleetlog.roads.load import distance_to_roads

    assert distance_to_roads(drawn, lanes.points[:, :2]).max() < 2.5
    _, (report,) = load_site(project_root / "sample_data" / "plant.xodr")
    assert report.dropped == {} and not any("no lane to follow" in n for n in report.notes)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("named", ["before", "after"])
def test_sections_of_a_road_join_whichever_of_them_says_so(write, rule, named):
    def lanes(says):
        return [lane(i, **({named: i} if says else {})) for i in (1, -1)]

    sections = section(0, *lanes(named == "after")), section(20, *lanes(named == "before"))
    edges, turns, _ = edges_of(write(straight("1", 0, 50, *sections, rule=rule)))
    forward = 1 if "LHT" in rule else -1
    assert turns == {(f"1:0:{forward}", f"1:1:{forward}"), (f"1:1:{-forward}", f"1:0:{-forward}")}
    assert all(np.linalg.norm(edges[a].points[-1] - edges[b].points[0]) < 1e-5 for a, b in turns)


def test_a_road_that_meets_its_junction_at_its_start_comes_in_there(write):
    """Road 1 is drawn away from junction 5, so that its lane 1 leads in."""
    first = road(
        "1",
        50,
        geometry(0, 50, 0, math.pi, 50),
        section(0, lane(1), lane(-1)),
        before=link("predecessor", "junction", 5),
    )
    _, second, _, _ = junction_map()
    on = straight(
        "9", 50, 10, section(0, lane(-1, None, -1)), after=link("successor", "road", 2, "start"), junction=5
    )
    meets = '<junction id="5"><connection id="0" incomingRoad="1" connectingRoad="9" contactPoint="start"><laneLink from="1" to="-1"/>'
    edges, turns, _ = edges_of(write(first, second, on, meets + "</connection></junction>"))
    assert turns == {("1:0:1", "9:0:-1"), ("9:0:-1", "2:0:-1")}
    assert np.linalg.norm(edges["1:0:1"].points[-1] - edges["9:0:-1"].points[0]) < 1e-5


def test_superelevation_lifts_the_left_side(write):
    roll = '<lateralProfile><superelevation s="0" a="0.1" b="0" c="0" d="0"/></lateralProfile>'
    edges, _, _ = edges_of(write(straight("1", 0, 40, section(0, lane(1), lane(-1)), inside=roll)))
    assert edges["1:0:1"].points[0, 1:] == pytest.approx([1.5 * math.cos(0.1), 1.5 * math.sin(0.1)])
    assert edges["1:0:-1"].points[0, 1:] == pytest.approx([-1.5 * math.cos(0.1), -1.5 * math.sin(0.1)])


@pytest.mark.parametrize("value", ["0", "-1", "9999"])
def test_a_limit_that_is_none_is_unknown(write, value):
    limit = f'<type s="0" type="town"><speed max="{value}"/></type>'
    assert math.isnan(
        edges_of(write(straight("1", 0, 40, section(0, lane(-1)), inside=limit)))[0]["1:0:-1"].speed_limit
    )
