"""GraphML, OSM XML and LIF: counts, directions, turns, speeds, and what is refused."""

import json
import math
import time

import numpy as np
import pytest
from pyproj import Geod

from fleetlog.errors import SiteError
from fleetlog.roads import load_site

GEOD = Geod(ellps="WGS84")


def turns(network):
    return {
        (network.edge_ids[i], network.edge_ids[j]) for i in range(len(network)) for j in network.successors(i)
    }


def refused(tmp_path, name, text, why):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(SiteError, match=why) as error:
        load_site(path)
    assert name in error.value.line() and "\n" not in error.value.line()


# --- GraphML


@pytest.fixture(scope="module")
def denver(shared_data):
    path = shared_data / "mapmatch" / "osmnx_drive_graph.graphml"
    before = time.process_time()
    site, (report,) = load_site(path)
    assert time.process_time() - before < 10.0
    return path, site, report


def test_denver_is_whole(denver):
    import networkx as nx

    path, site, report = denver
    network, graph = site.roads(), nx.read_graphml(path, force_multigraph=True)
    assert (report.read, report.kept, report.dropped) == (
        graph.number_of_edges(),
        graph.number_of_edges(),
        {},
    )
    assert len(network) == graph.number_of_edges() == 1028
    assert set(network.node_ids) <= set(graph.nodes)


def test_denver_is_as_long_as_osmnx_and_the_ellipsoid_say(denver):
    import networkx as nx

    path, site, _ = denver
    network, graph = site.roads(), nx.read_graphml(path, force_multigraph=True)
    for u, v, key, data in list(graph.edges(keys=True, data=True))[::7]:
        name = f"{u}_{v}_{key}"
        edge = network.index.get(name)
        if edge is None:
            # The direction against OSM's: named after its twin.
            edge = next(
                network.index[f"-{v}_{u}_{k}"] for k in graph[v][u] if f"-{v}_{u}_{k}" in network.index
            )
        text = data.get("geometry")
        spots = (
            [tuple(map(float, p.split())) for p in text[text.index("(") + 1 : -1].split(",")]
            if text
            else [(float(graph.nodes[n]["x"]), float(graph.nodes[n]["y"])) for n in (u, v)]
        )
        true = GEOD.line_length(*zip(*spots, strict=True))
        assert network.length[edge] == pytest.approx(true, rel=1e-5, abs=1e-3)
        # OSMnx measures on a sphere
        assert network.length[edge] == pytest.approx(float(data["length"]), rel=0.005)


def test_denver_keeps_its_one_way_roads_and_pairs_the_others(denver):
    import networkx as nx

    path, site, _ = denver
    network, graph = site.roads(), nx.read_graphml(path, force_multigraph=True)
    single = sum(data["oneway"] == "True" for _, _, data in graph.edges(data=True))
    # Of the others all but dangling ends of the cut-out have their twin.
    assert (network.reverse < 0).sum() >= single
    assert (network.reverse >= 0).sum() > 0.95 * (len(network) - single)
    assert np.nanmin(network.speed_limit) == pytest.approx(20 / 3.6)
    assert np.nanmax(network.speed_limit) == pytest.approx(30 * 0.44704)


def test_the_direction_against_osms_has_the_minus(denver):
    import networkx as nx

    path, site, _ = denver
    network, graph = site.roads(), nx.read_graphml(path, force_multigraph=True)
    for i in np.flatnonzero(network.reverse >= 0):
        name = network.edge_ids[i]
        u, v, key = name.lstrip("-").split("_")
        there, back = (graph[a][b][int(key)].get("reversed") for a, b in ((u, v), (v, u)))
        if {there, back} == {"True", "False"}:
            assert there == "False", "the road is named after the edge along OSM's direction"


GRAPHML = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="a" for="node" attr.name="x"/><key id="b" for="node" attr.name="y"/><key id="h" for="node" attr.name="elevation"/>
<key id="c" for="graph" attr.name="crs"/><key id="s" for="edge" attr.name="speed_kph"/><key id="g" for="edge" attr.name="geometry"/>
<graph edgedefault="directed"><data key="c">{crs}</data>
<node id="1"><data key="a">{x}</data><data key="b">{y}</data><data key="h">3</data></node>
<node id="2"><data key="a">{x2}</data><data key="b">{y}</data><data key="h">5</data></node>
{edges}</graph></graphml>"""
DEGREES = dict(crs="epsg:4326", x=9.15, x2=9.151, y=49.97)


def test_a_projected_graph_is_brought_to_the_ground(tmp_path):
    path = tmp_path / "g.graphml"
    edge = '<edge source="1" target="2" id="0"><data key="s">36</data></edge>'
    path.write_text(GRAPHML.format(crs="epsg:25832", x=500000, x2=501000, y=5530000, edges=edge))
    site, _ = load_site(path)
    assert site.roads().length[0] == pytest.approx(math.hypot(1000 / 0.9996, 2), abs=0.01)
    assert site.roads().speed_limit[0] == pytest.approx(10.0) and site.roads().has_elevation
    assert site.frame.longitude == pytest.approx(9.0, abs=0.02)


@pytest.mark.parametrize(
    "edges, crs, why",
    [
        ('<edge source="1" target="7"/>', "epsg:4326", "there is no node '7'"),
        ("", "epsg:4326", "no road in it; edges read: 0"),
        ('<edge source="1" target="2"><data key="g">POINT (1 2)</data></edge>', "epsg:4326", "is no LINESTRING"),
        ('<edge source="1" target="2"><data key="g">LINESTRING (1 2)</data></edge>', "epsg:4326", "LINESTRING is broken"),
        ('<edge source="1" target="2"><data key="g">LINESTRING (1 a, 2 3)</data></edge>', "epsg:4326", "'a' is not a number"),
        ('<edge source="1" target="2"/>', "moon", "crs 'moon' is not known"),
    ],
)  # fmt: skip
def test_graphml_refused_in_one_line(tmp_path, edges, crs, why):
    refused(tmp_path, "g.graphml", GRAPHML.format(**{**DEGREES, "crs": crs}, edges=edges), why)
    refused(tmp_path, "g.graphml", "<graphml/>", "has no graph")


# --- OSM

#        4
#        |B
#  1--A--2--A--3      B meets the middle of A; C one-way from 3 to 5; a footway and a closed road are left out
#               \C
#                5
OSM = """<osm version="0.6">
<node id="1" lat="49.97" lon="9.150"/><node id="2" lat="49.97" lon="9.151"/><node id="3" lat="49.97" lon="9.152"/>
<node id="4" lat="49.971" lon="9.151"/><node id="5" lat="49.969" lon="9.153"/>
<way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="service"/><tag k="maxspeed" v="10 mph"/></way>
<way id="20"><nd ref="2"/><nd ref="4"/><tag k="highway" v="residential"/><tag k="width" v="3.5 m"/></way>
<way id="30"><nd ref="3"/><nd ref="5"/><nd ref="99"/><tag k="highway" v="residential"/><tag k="oneway" v="{oneway}"/></way>
<way id="40"><nd ref="1"/><nd ref="4"/><tag k="highway" v="footway"/></way>
<way id="50"><nd ref="1"/><nd ref="5"/><tag k="highway" v="service"/><tag k="access" v="no"/></way>
<way id="60"><nd ref="1"/><nd ref="5"/><tag k="building" v="yes"/></way>
<way id="70"><nd ref="98"/><nd ref="99"/><tag k="highway" v="service"/></way>
{relation}</osm>"""
RESTRICTION = (
    '<relation id="7"><member type="way" ref="10" role="from"/><member type="{via}" ref="2" role="via"/>'
    '<member type="way" ref="20" role="to"/><tag k="type" v="restriction"/><tag k="restriction" v="{rule}"/></relation>'
)


def osm(tmp_path, oneway="yes", relation=""):
    path = tmp_path / "map.osm"
    path.write_text(OSM.format(oneway=oneway, relation=relation))
    site, (report,) = load_site(path)
    return site.roads(), report


def test_osm_ways_are_split_where_they_meet_and_counted(tmp_path):
    network, report = osm(tmp_path)
    assert network.edge_ids == ("10:0", "-10:0", "10:1", "-10:1", "20", "-20", "30")
    assert (report.read, report.kept) == (6, 3)
    assert report.dropped == {"class footway": 1, "closed to traffic": 1, "without nodes in the file": 1}
    assert any("2 ways over nodes" in note for note in report.notes)
    assert network.speed_limit[0] == pytest.approx(4.4704) and network.width[4] == 3.5
    spot = GEOD.line_length([9.150, 9.151], [49.97, 49.97])
    assert network.length[0] == pytest.approx(spot, abs=1e-3)
    assert {("10:0", "10:1"), ("10:0", "20"), ("-20", "-10:0"), ("10:1", "30")} <= turns(network)


@pytest.mark.parametrize("oneway, ids", [("yes", {"30"}), ("-1", {"-30"}), ("no", {"30", "-30"})])
def test_osm_one_way(tmp_path, oneway, ids):
    network, _ = osm(tmp_path, oneway)
    assert {e for e in network.edge_ids if "30" in e} == ids


def test_osm_turn_restrictions(tmp_path):
    free = turns(osm(tmp_path)[0])
    no_turn = turns(osm(tmp_path, relation=RESTRICTION.format(via="node", rule="no_left_turn"))[0])
    assert free - no_turn == {("10:0", "20"), ("-10:1", "20")}
    only = turns(osm(tmp_path, relation=RESTRICTION.format(via="node", rule="only_left_turn"))[0])
    assert free - only == {("10:0", "10:1"), ("-10:1", "-10:0")}
    network, report = osm(tmp_path, relation=RESTRICTION.format(via="way", rule="no_left_turn"))
    assert turns(network) == free and any("over ways" in note for note in report.notes)


def test_osm_classes_are_a_choice(tmp_path):
    osm(tmp_path)
    (tmp_path / "site.toml").write_text('[network]\nfile = "map.osm"\nroad_classes = ["footway"]\n')
    site, (report,) = load_site(tmp_path)
    assert set(site.roads().roads) == {"40"} and report.dropped["class service"] == 3


def test_osm_refused_in_one_line(tmp_path):
    refused(tmp_path, "map.osm", "<osm/>", "no driven road in it; ways with a highway tag: 0")
    refused(tmp_path, "map.osm", '<osm><node id="1" lat="x" lon="9"/></osm>', "node 1: 'x' is not a number")
    refused(tmp_path, "map.osm", '<osm><node id="1" lat="1"/></osm>', "node 1: None is not a number")
    refused(tmp_path, "map.osm", "<osm><node>", "not well-formed")


# --- LIF


def node(name, x, y, *actions):
    kinds = [{"vehicleTypeId": "t", "actions": [{"actionType": a} for a in actions]}]
    return {"nodeId": name, "nodePosition": {"x": x, "y": y}, "vehicleTypeNodeProperties": kinds}


def track(name, start, end, **more):
    kind = {"vehicleTypeId": "t", "rotationAllowed": False, **more}
    return {"edgeId": name, "startNodeId": start, "endNodeId": end, "vehicleTypeEdgeProperties": [kind]}


QUARTER = {
    "degree": 2,
    "knotVector": [0, 0, 0, 1, 1, 1],
    "controlPoints": [{"x": 10, "y": 0}, {"x": 20, "y": 0, "weight": math.sqrt(0.5)}, {"x": 20, "y": 10}],
}


def lif(tmp_path, edges, nodes=None, stations=(), version="1.0.0"):
    path = tmp_path / "layout.json"
    nodes = nodes or [node("A", 0, 0, "pick"), node("B", 10, 0), node("C", 20, 10, "startCharging")]
    layouts = {"layouts": [{"layoutId": "1", "nodes": nodes, "edges": edges, "stations": list(stations)}]}
    new = {"origins": [{"originId": "o", **layouts}]} if version.startswith("2") else layouts
    text = json.dumps({"metaInformation": {"lifVersion": version}, **new})
    # Version 2 says mobile robot for vehicle, and what is done as required or feasible.
    words = {"vehicleType": "mobileRobotType", '"actions"': '"feasibleActions"'}
    for old, word in words.items() if version.startswith("2") else ():
        text = text.replace(old, word)
    path.write_text(text)
    site, (report,) = load_site(path)
    return site, report


VERSIONS = pytest.mark.parametrize("version", ["1.0.0", "2.0.0"])


@VERSIONS
def test_lif_edges_keep_their_ids_and_follow_their_trajectories(tmp_path, version):
    edges = [
        track("e1", "A", "B", maxSpeed=1.5),
        track("e2", "B", "A"),
        track("e3", "B", "C", trajectory=QUARTER),
    ]
    site, report = lif(tmp_path, edges, version=version)
    network = site.roads()
    assert network.edge_ids == ("e1", "e2", "e3") and (report.read, report.kept) == (3, 3)
    assert network.speed_limit[0] == 1.5 and np.isnan(network.speed_limit[1]) and site.frame is None
    # A NURBS of degree 2 with that weight is an exact quarter of a circle of radius 10 about (10, 10).
    assert network.length[2] == pytest.approx(5 * math.pi, rel=1e-3)
    assert np.hypot(*(network.polyline(2)[:, :2] - [10, 10]).T) == pytest.approx(10.0, abs=1e-9)
    # Turning round on the spot only where nothing else leads on.
    assert turns(network) == {("e1", "e3"), ("e2", "e1")}


@VERSIONS
def test_lif_stations_are_places_where_actions_tell_what_for(tmp_path, version):
    stations = [
        {"stationId": "S1", "interactionNodeIds": ["A"]},
        {"stationId": "S2", "interactionNodeIds": ["C"]},
        {"stationId": "S3", "interactionNodeIds": ["B"]},
    ]
    site, report = lif(tmp_path, [track("e1", "A", "B")], stations=stations, version=version)
    assert [(p.id, p.kind, p.x) for p in site.places] == [("S1", "pick", 0.0), ("S2", "charge", 20.0)]
    assert any("1 station left out" in note for note in report.notes)


def floors(*origins):
    """Version 2: layouts of nodes and edges under named origins."""
    listed = [
        {"originId": name, "layouts": [{"layoutId": name, "nodes": nodes, "edges": edges}]}
        for name, nodes, edges in origins
    ]
    text = json.dumps({"metaInformation": {"lifVersion": "2.0.0"}, "origins": listed})
    return text.replace("vehicleType", "mobileRobotType")


UPPER = ("upper", [node("C", 0, 0), node("D", 5, 0)], [track("e2", "C", "D", trajectory={
    "degree": 1, "knotVector": [0, 0, 0.5, 1, 1], "controlPoints": [{"x": 0, "y": 0}, {"x": 2, "y": 1}, {"x": 5, "y": 0}],
})])  # fmt: skip
GROUND = ("ground", [node("A", 0, 0), node("B", 10, 0)], [track("e1", "A", "B"), track("lift", "B", "C")])


def test_lif_origins_lie_where_the_site_says(tmp_path):
    (tmp_path / "l.json").write_text(floors(GROUND, UPPER))
    frame = '[[map_frame]]\nname = "{}"\nshift = [{}.0, 0.0]\nrotation = {}\n'
    (tmp_path / "site.toml").write_text(
        frame.format("ground", 0, 0.0)
        + frame.format("upper", 20, math.pi / 2)
        + '[network]\nfile = "l.json"\n'
    )
    site, (report,) = load_site(tmp_path)
    n = site.roads()
    assert n.polyline(n.edge("e1"))[:, :2].tolist() == [[0, 0], [10, 0]]
    assert n.polyline(n.edge("e2"))[:, :2] == pytest.approx(np.array([[20, 0], [19, 2], [20, 5]]))
    assert n.polyline(n.edge("lift"))[-1, :2] == pytest.approx([20, 0])
    assert not report.notes


def test_lif_origins_of_which_nothing_is_said_are_told(tmp_path):
    (tmp_path / "l.json").write_text(floors(GROUND, UPPER))
    site, (report,) = load_site(tmp_path / "l.json")
    assert site.roads().edge_ids == ("e1", "lift", "e2")
    assert any("'ground', 'upper' have no [[map_frame]]" in note for note in report.notes)
    (tmp_path / "l.json").write_text(floors(GROUND[:2] + (GROUND[2][:1],)))
    assert not load_site(tmp_path / "l.json")[1][0].notes


WRONG_TRACKS = [
    (track("e1", "A", "Z"), "there is no node 'Z'"),
    (track("e1", "A", "B", maxSpeed="fast"), "'fast' is not a number"),
    (track("e1", "A", "B", trajectory={"degree": 2}), "no controlPoints"),
    (track("e1", "A", "B", trajectory={**QUARTER, "knotVector": [0, 1]}), "has 2 knots for 3 control points"),
]


@pytest.mark.parametrize("edge, why", WRONG_TRACKS)
def test_lif_refused_in_one_line(tmp_path, edge, why):
    with pytest.raises(SiteError, match=why) as error:
        lif(tmp_path, [edge])
    assert "layout.json, edge e1" in error.value.line()


def test_wrong_lif_documents(tmp_path):
    refused(tmp_path, "l.json", '{"layouts": 3}', "has no layouts")
    refused(tmp_path, "l.json", '{"origins": 3}', "has no layouts")
    refused(tmp_path, "l.json", '{"origins": [{"layouts": 3}]}', "layouts: is not a list")
    refused(tmp_path, "l.json", floors(GROUND, ("u", GROUND[1], [])), "node A: occurs twice")
    refused(tmp_path, "l.json", '{"layouts": [3]}', "not an object")
    refused(tmp_path, "l.json", '{"layouts": [{"nodes": [{"nodeId": "a"}]}]}', "node a: has no position")
    refused(tmp_path, "l.json", '{"layouts": []}', "no road in it; edges read: 0")
    refused(tmp_path, "l.json", '{"layouts": [}', "not valid JSON")
