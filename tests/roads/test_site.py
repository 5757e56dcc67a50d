"""Site files: what they hold, and one line for every way to get them wrong."""

import json

import numpy as np
import pytest

from fleetlog.core.site import site_from_dict, site_to_dict
from fleetlog.errors import SiteError
from fleetlog.roads import load_site

ROAD = {
    "type": "Feature",
    "properties": {"id": "r"},
    "geometry": {"type": "LineString", "coordinates": [[9.15, 49.97], [9.151, 49.97]]},
}
FULL = """
name = "works"
[frame]
latitude = 49.97
longitude = 9.15
[network]
file = "roads.geojson"
traffic = "left"
[[place]]
id = "p"
kind = "charge"
x = 1.0
y = 2
plugs = 3
power = 9000.0
[[zone]]
polygon = [[0, 0], [10, 0], [10, 10], [0, 0]]
covered = true
[[zone]]
id = "slow"
polygon = [[0, 0], [10, 0], [10, 10]]
speed_limit = 2
[[building]]
id = "hall"
polygon = [[0, 0], [10, 0], [10, 10]]
height = 8
"""


@pytest.fixture
def folder(tmp_path):
    inner = tmp_path / "plant"
    inner.mkdir()
    roads = json.dumps({"type": "FeatureCollection", "features": [ROAD]})
    (inner / "roads.geojson").write_text(roads)
    (tmp_path / "outside.geojson").write_text(roads)
    return inner


def load(folder, text):
    (folder / "site.toml").write_text(text)
    return load_site(folder / "site.toml")


def test_everything_that_a_site_file_can_say(folder):
    site, reports = load(folder, FULL)
    assert (site.name, site.traffic, site.frame.latitude) == ("works", "left", 49.97)
    assert (site.places[0].plugs, site.places[0].power, site.places[0].kind) == (3, 9000.0, "charge")
    assert [z.id for z in site.zones] == ["zone-1", "slow"]
    assert site.zones[0].covered and np.isnan(site.zones[0].speed_limit) and len(site.zones[0].polygon) == 3
    assert site.zones[1].speed_limit == 2.0 and site.buildings[0].height == 8.0
    assert site.roads().edge_ids == ("r", "-r")
    assert site.source["network"]["file"] == "roads.geojson" and len(site.source["site"]["sha256"]) == 64
    assert len(reports) == 1


def test_a_site_survives_json_whole(folder):
    site, _ = load(folder, FULL)
    once = site_to_dict(site)
    again = site_from_dict(json.loads(json.dumps(once)))
    assert site_to_dict(again) == once
    assert (again.roads().points == site.roads().points).all()
    assert (again.roads().next_edges == site.roads().next_edges).all()


def test_a_folder_stands_for_its_site_file_and_a_site_needs_no_roads(folder):
    (folder / "site.toml").write_text("")
    site, reports = load_site(folder)
    assert site.name == "plant" and site.network is None and reports == []


def test_a_place_off_the_roads_is_told_of(folder):
    _, (report,) = load(folder, FULL.replace("y = 2", "y = 200"))
    assert any("place 'p' is 200 m" in note for note in report.notes)
    _, (report,) = load(folder, FULL)
    assert not any("place" in note for note in report.notes)


def test_an_absolute_path_may_lead_anywhere_and_a_relative_one_may_not(folder):
    outside = folder.parent / "outside.geojson"
    site, _ = load(folder, f'[network]\nfile = "{outside.as_posix()}"\n')
    assert len(site.roads()) == 2
    with pytest.raises(SiteError, match="leads out of the site's folder"):
        load(folder, '[network]\nfile = "../outside.geojson"\n')
    (folder / "link.geojson").symlink_to(outside)
    with pytest.raises(SiteError, match="leads out of the site's folder"):
        load(folder, '[network]\nfile = "link.geojson"\n')


WRONG = {
    "[[places]]": "place",
    "[frames]": "frame",
    "[frame]\nlatitude = 99\nlongitude = 9": "frame.latitude: 99 is outside -90 to 90",
    "[frame]\nlatitude = 49": "longitude is missing",
    "[frame]\nlatitude = 49\nlongitude = '9'": "frame.longitude: '9' is not a number",
    "[frame]\nlatitude = 49\nlongitude = nan": "nan is not a finite number",
    "frame = 3": "is not a table",
    "[network]": "file is missing",
    "[network]\nfile = 'roads.geojson'\ntrafic = 'left'": "did you mean 'traffic'?",
    "[network]\nfile = 'roads.geojson'\ntraffic = 'both'": "is none of right, left",
    "[network]\nfile = 'other.geojson'": "no such file 'other.geojson'",
    "[network]\nfile = 'roads.geojson'\nlane_types = 'driving'": "is not a list",
    "[[place]]\nid = 'a'\nkind = 'dock'\nx = 1\ny = 2": "place[0].kind: 'dock' is none of pick, drop, park, charge",
    "[[place]]\nid = 'a'\nkind = 'pick'\nx = 1": "place[0]: y is missing",
    "[[place]]\nid = 'a'\nkind = 'pick'\nx = 1\ny = 2\nplug = 1": "did you mean 'plugs'?",
    "[[place]]\nid = 'a'\nkind = 'pick'\nx = 1\ny = 2\nplugs = 0": "0 is not a whole number from 1 to",
    "[[place]]\nid = 'a'\nkind = 'pick'\nx = 1\ny = 2\n" * 2: "the id 'a' occurs twice",
    "[place]\nid = 'a'": "write [[place]]",
    "[[zone]]\npolygon = [[0, 0], [1, 1], [0, 0]]": "zone[0].polygon",
    "[[zone]]\npolygon = [[0, 0], [1, 1, 1], [0, 2]]": "is not a list of corners",
    "[[zone]]\nid = 'z'": "polygon is missing",
    "[[zone]]\npolygon = [[0, 0], [1, 1], [0, 2]]\ncovered = 1": "is neither true nor false",
    "[[building]]\npolygon = [[0, 0], [1, 1], [0, 2]]\nheight = -2": "is outside 0 to 1000",
    "name = ": "not readable as TOML",
    "[frame]\nlatitude = 10\nlongitude = 10\n[network]\nfile = 'roads.geojson'": "km from the site's frame",
}


@pytest.mark.parametrize("text, why", WRONG.items())
def test_refused_in_one_line(folder, text, why):
    with pytest.raises(SiteError) as error:
        load(folder, text)
    line = error.value.line()
    assert why in line and "\n" not in line
    assert "site.toml" in line or "roads" in line


def test_no_file_an_empty_one_and_one_of_no_known_format(tmp_path):
    with pytest.raises(SiteError, match="no such file"):
        load_site(tmp_path / "none.xodr")
    (tmp_path / "empty.xodr").write_text("\n")
    with pytest.raises(SiteError, match="empty"):
        load_site(tmp_path / "empty.xodr")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n")
    with pytest.raises(SiteError, match=r"known are \.geojson, \.graphml"):
        load_site(tmp_path / "picture.png")


def test_content_counts_for_more_than_the_suffix(tmp_path):
    path = tmp_path / "roads.json"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [ROAD]}))
    assert load_site(path)[0].roads().edge_ids == ("r", "-r")
