"""openTCS and Open-RMF models of a site: read back as they were, and whole after the schemas of those projects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Place, Site
from fleetlog.exporters.base import export_dataset
from fleetlog.roads import load_site
from fleetlog.store import Dataset, DatasetWriter

PLACES = (Place("dock 1", "pick", 12.0, 1.5), Place("rack", "drop", 20.0, 12.0), Place("P", "park", 0.0, 0.0), Place("C", "charge", 20.0, 18.0))  # fmt: skip
# the attributes that model-6.0.0.xsd of openTCS requires
REQUIRED = {
    "model": {"version", "name"},
    "point": {"name", "positionX", "positionY", "positionZ", "type"},
    "maxVehicleBoundingBox": {"length", "width", "height", "referenceOffsetX", "referenceOffsetY"},
    "path": {
        "name",
        "sourcePoint",
        "destinationPoint",
        "length",
        "maxVelocity",
        "maxReverseVelocity",
        "locked",
    },
    "location": {"name", "positionX", "positionY", "positionZ", "type", "locked"},
}
ORDER = ["point", "path", "locationType", "location"]


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    """An L of one road driven both ways, and a one-way road back with a bend."""
    line = lambda *xy: np.array([(*p, 0.0) for p in xy])
    ell = Edge("ell", "a", "c", line((0, 0), (20, 0), (20, 20)), "ell", 2.0)
    back = Edge("back", "c", "a", line((20, 20), (0, 20), (0, 0)), "back")
    site = Site("plant", None, build_network([ell, reversed_edge(ell), back]), places=PLACES)
    with DatasetWriter.create(tmp_path / "data", "simulated", site):
        pass
    return Dataset(tmp_path / "data")


@pytest.mark.parametrize("name", ["opentcs", "open-rmf"])
def test_what_was_written_is_read_as_it_was(dataset: Dataset, tmp_path: Path, name: str) -> None:
    out = tmp_path / {"opentcs": "plant.xml", "open-rmf": "0.yaml"}[name]
    summary = export_dataset(dataset, name, out)
    found, _ = load_site(out)
    true, n = dataset.site.roads(), found.roads()
    assert len(n) == summary["edges"]
    assert n.length.sum() == pytest.approx(true.length.sum(), abs=1e-6)
    limits = np.nan_to_num(n.speed_limit, nan=1.0)
    assert (n.length * limits).sum() == pytest.approx(40 * 2.0 * 2 + 40 * 1.0, abs=1e-6)
    assert {(p.id, p.kind) for p in found.places} == {(p.id, p.kind) for p in PLACES}
    where = {p.id: (p.x, p.y) for p in found.places}
    assert where["dock 1"] == pytest.approx((12.0, 0.0)) and where["rack"] == pytest.approx((20.0, 12.0))


@pytest.mark.parametrize("name", ["opentcs", "open-rmf"])
def test_every_way_through_the_model_is_one_through_the_site(
    dataset: Dataset, tmp_path: Path, name: str
) -> None:
    """From any node to any other the shortest way is as long."""
    import networkx as nx

    out = tmp_path / {"opentcs": "plant.xml", "open-rmf": "0.yaml"}[name]
    export_dataset(dataset, name, out)
    ways = []
    for n in (dataset.site.roads(), load_site(out)[0].roads()):
        graph = nx.DiGraph()
        spot = [tuple(np.round(p[:2], 3)) for p in n.node_points]
        for i in range(len(n)):
            graph.add_edge(spot[n.start[i]], spot[n.end[i]], weight=min(float(n.length[i]), graph.get_edge_data(spot[n.start[i]], spot[n.end[i]], {"weight": 1e9})["weight"]))  # fmt: skip
        ways.append(dict(nx.all_pairs_dijkstra_path_length(graph)))
    for a, targets in ways[0].items():
        for b, length in targets.items():
            assert ways[1][a][b] == pytest.approx(length, abs=1e-6)


def test_a_plant_model_has_what_its_schema_requires(dataset: Dataset, tmp_path: Path) -> None:
    export_dataset(dataset, "opentcs", tmp_path / "plant.xml")
    model = etree.parse(str(tmp_path / "plant.xml")).getroot()
    for element in model.iter():
        assert REQUIRED.get(element.tag, set()) <= set(element.attrib)
    kinds = [ORDER.index(child.tag) for child in model]
    assert kinds == sorted(kinds)
    points = {p.get("name") for p in model.iterfind("point")}
    paths = {p.get("name"): p for p in model.iterfind("path")}
    assert len(paths) == len(list(model.iterfind("path")))
    assert all(p.get("sourcePoint") in points and p.get("destinationPoint") in points for p in paths.values())
    for point in model.iterfind("point"):
        assert point[0].tag == "maxVehicleBoundingBox"
        assert all(
            paths[o.get("name")].get("sourcePoint") == point.get("name")
            for o in point.iterfind("outgoingPath")
        )
    types = {t.get("name") for t in model.iterfind("locationType")}
    assert all(
        v.get("type") in types and v.find("link").get("point") in points for v in model.iterfind("location")
    )


def test_a_site_without_places_has_none(dataset: Dataset, tmp_path: Path) -> None:
    bare = replace(dataset.site, places=())
    with DatasetWriter.create(tmp_path / "bare", "simulated", bare):
        pass
    export_dataset(tmp_path / "bare", "open-rmf", tmp_path / "0.yaml")
    assert load_site(tmp_path / "0.yaml")[0].places == ()
