"""OpenSCENARIO: what a player of scenarios reads is where the trucks were, and when."""

from xml.etree import ElementTree

import numpy as np
import pytest

from fleetlog.errors import DataError
from fleetlog.exporters import openscenario
from fleetlog.exporters.base import export_dataset

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
