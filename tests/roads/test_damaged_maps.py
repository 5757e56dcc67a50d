"""Damaged maps of every format: read, or refused in one line; never another error."""

import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_fleet_formats import BUILDING, NET, UPSTAIRS, WGS84
from test_opendrive import junction_map, located
from test_other_formats import DEGREES, GRAPHML, OSM, QUARTER, RESTRICTION, node, track
from xodr_maps import document, geometry, lane, road, section

from fleetlog.errors import SiteError
from fleetlog.roads import load_site

SHAPES = (
    '<spiral curvStart="0" curvEnd="0.1"/>', '<poly3 a="0" b="0" c="0.01" d="0"/>',
    '<paramPoly3 pRange="normalized" aU="0" bU="10" cU="0" dU="0" aV="0" bV="0" cV="1" dV="0"/>',
)  # fmt: skip
LINE = {"type": "LineString", "coordinates": [[9.15, 49.97, 1.0], [9.151, 49.97, 2.0]]}
FEATURE = {
    "type": "Feature",
    "properties": {"id": "r", "oneway": False, "speed_limit": 3.0, "from": "a", "to": "b"},
}
LAYOUT = {
    "layoutId": "1", "nodes": [node("A", 0, 0, "pick"), node("B", 10, 0), node("C", 20, 10)],
    "edges": [track("e1", "A", "B", maxSpeed=1.5), track("e2", "B", "C", trajectory=QUARTER)],
    "stations": [{"stationId": "S", "interactionNodeIds": ["A"]}],
}  # fmt: skip
MAPS = {
    "map.xodr": document(
        *junction_map(),
        *(road(f"s{k}", 10, geometry(0, 0, 50 * k, 0, 10, shape), section(0, lane(-1))) for k, shape in enumerate(SHAPES)),
        header=located("+proj=utm +zone=32 +datum=WGS84", '<offset x="500000" y="5530000" hdg="0.1"/>'),
    ),
    "map.geojson": json.dumps({"type": "FeatureCollection", "features": [{**FEATURE, "geometry": LINE}]}),
    "map.graphml": GRAPHML.format(**DEGREES, edges='<edge source="1" target="2" id="0"><data key="s">36</data></edge>'),
    "map.osm": OSM.format(oneway="yes", relation=RESTRICTION.format(via="node", rule="no_left_turn")),
    "map.json": json.dumps({"metaInformation": {"lifVersion": "1.0.0"}, "layouts": [LAYOUT]}),
    "two.json": json.dumps({"origins": [{"originId": "o", "layouts": [LAYOUT]}, {"originId": "p", "layouts": []}]}),
    "map.building.yaml": BUILDING + "    fiducials: [[0, 0, lift], [200, 0, stairs]]\n" + UPSTAIRS,
    "wgs84.building.yaml": WGS84,
    "map.net.xml": NET,
}  # fmt: skip
NASTY = [
    "",
    "x",
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "1e9",
    "null",
    "true",
    "[]",
    "{}",
    '"',
    "<",
    "&",
    "é",
    "99999999999999999999",
]


def damaged(text, data):
    """The text with one value exchanged, or a stretch of it cut out."""
    if data.draw(st.booleans(), label="exchange"):
        values = [
            m.span(1)
            for m in re.finditer(r'"([^"<>]*)"|(?<=[\[:,> ])(-?[\d.]+)(?=[\]},<])', text)
            if m.span(1)[0] >= 0
        ]
        a, b = data.draw(st.sampled_from(values), label="value")
        return text[:a] + data.draw(st.sampled_from(NASTY), label="nasty") + text[b:]
    a = data.draw(st.integers(0, len(text)), label="from")
    b = min(len(text), a + data.draw(st.integers(1, 200), label="length"))
    return text[:a] + text[b:]


@pytest.mark.parametrize("name", MAPS)
def test_whole_maps_load(tmp_path, name):
    (tmp_path / name).write_text(MAPS[name])
    assert len(load_site(tmp_path / name)[0].roads())


@pytest.mark.parametrize("name", MAPS)
@given(data=st.data())
@settings(
    max_examples=120,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_damaged_maps_are_read_or_refused_in_one_line(tmp_path, name, data):
    path = tmp_path / name
    path.write_text(damaged(MAPS[name], data), encoding="utf-8")
    try:
        site, _ = load_site(path)
    except SiteError as error:
        assert "\n" not in error.line() and name in error.line()
        return
    assert np.isfinite(site.roads().points).all() and np.isfinite(site.roads().length).all()
