"""OpenSCENARIO: what a player of scenarios reads is where the trucks were, and when."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from fleetlog.errors import DataError
from fleetlog.exporters import openscenario
from fleetlog.exporters.base import export_dataset
from fleetlog.store import Dataset
from fleetlog.store.documents import digest

pytest.importorskip("scenariogeneration", reason="fleetlog[scenario] is not installed")


def test_every_vertex_is_a_row_at_its_time(make_dataset, tmp_path):
    dataset = make_dataset(vehicles=2)
    summary = export_dataset(dataset, "openscenario", tmp_path / "out.xosc")
    root = ElementTree.parse(tmp_path / "out.xosc").getroot()
    names = [o.get("name") for o in root.iter("ScenarioObject")]
    assert names == list(dataset.vehicles)
    begin = min(int(dataset.read(v).time[0]) for v in names)
    rows = 0
    for group, name in zip(root.iter("ManeuverGroup"), names, strict=True):
        assert next(group.iter("EntityRef")).get("entityRef") == name
        t = dataset.read(name)
        known = np.isfinite(t.floats("x")) & np.isfinite(t.floats("y"))
        found = [
            [float(v.get("time")), *(float(v.find(".//WorldPosition").get(k)) for k in "xy")]
            for v in group.iter("Vertex")
        ]
        expected = np.column_stack([1e-6 * (t.time - begin), t.floats("x"), t.floats("y")])[known]
        np.testing.assert_allclose(found, expected, atol=1e-6)
        rows += len(found)
    assert summary["rows"] == rows
    header = root.find("FileHeader")
    assert (header.get("revMajor"), header.get("revMinor")) == ("1", "2")


def test_a_scenario_too_large_is_refused_in_one_line(make_dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(openscenario, "MOST", 10)
    with pytest.raises(DataError, match="too many for one scenario") as error:
        export_dataset(make_dataset(vehicles=2), "openscenario", tmp_path / "out.xosc")
    assert "--vehicle" in str(error.value)
    assert not (tmp_path / "out.xosc").exists()


@pytest.fixture
def on_opendrive(make_dataset, tmp_path):
    """A dataset whose map was read from an OpenDRIVE file, and that file."""
    file = tmp_path / "maps" / "plant.xodr"
    file.parent.mkdir()
    file.write_text("<OpenDRIVE/>")
    source = {"network": {"file": file.name, "path": str(file), "sha256": digest(file)}}
    path = make_dataset(vehicles=1).path
    site = json.loads((path / "site.json").read_text())
    (path / "site.json").write_text(json.dumps({**site, "source": source}))
    return Dataset(path), file


def road_network(path):
    return [n.get("filepath") for n in ElementTree.parse(path).getroot().iter("LogicFile")]


def test_the_road_network_is_the_file_that_was_read(on_opendrive, tmp_path):
    dataset, file = on_opendrive
    out = tmp_path / "scenario" / "fleet.xosc"
    export_dataset(dataset, "openscenario", out)
    (name,) = road_network(out)
    assert (out.parent / name).read_bytes() == file.read_bytes()


def test_other_maps_leave_the_road_network_empty(make_dataset, tmp_path):
    export_dataset(make_dataset(vehicles=1), "openscenario", tmp_path / "out.xosc")
    assert road_network(tmp_path / "out.xosc") == []


def test_a_truck_is_as_long_and_wide_as_that_of_the_simulation(make_dataset, tmp_path):
    def box(dataset):
        out = tmp_path / "out.xosc"
        export_dataset(dataset, "openscenario", out, overwrite=True)
        size = next(ElementTree.parse(out).getroot().iter("Dimensions"))
        return float(size.get("length")), float(size.get("width"))

    dataset = make_dataset(vehicles=1)
    assert box(dataset) == (openscenario.LENGTH, openscenario.WIDTH)
    meta = json.loads((dataset.path / "dataset.json").read_text())
    meta["provenance"]["truck"] = {"length": 3.2, "width": 1.3}
    (dataset.path / "dataset.json").write_text(json.dumps(meta))
    assert box(Dataset(dataset.path)) == (3.2, 1.3)
