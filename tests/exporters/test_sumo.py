"""SUMO's own tools read what is exported, and what SUMO writes is read back."""

from __future__ import annotations

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from fleetlog.exporters.base import export_dataset
from fleetlog.importers import sumo_fcd
from fleetlog.importers._open import ReadReport
from fleetlog.importers.base import ReadOptions

sumo = pytest.importorskip("sumo", reason="the wheel eclipse-sumo is not installed")
HOME = Path(sumo.SUMO_HOME)


def run(program: str, *arguments: object) -> str:
    command = [str(HOME / "bin" / program), *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, env={**os.environ, "SUMO_HOME": str(HOME)}
    )
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    return done.stdout + done.stderr


def test_netconvert_and_sumolib_read_the_network(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset()
    net = tmp_path / "square.net.xml"
    assert export_dataset(dataset, "sumo-net", net)["edges"] == 9
    assert "Warning" not in run("netconvert", "-s", net, "-o", tmp_path / "again.net.xml")
    sys.path.insert(0, str(HOME / "tools"))
    sumolib = pytest.importorskip("sumolib")
    read, roads = sumolib.net.readNet(str(net)), dataset.site.roads()
    assert {e.getID() for e in read.getEdges()} == set(roads.edge_ids)
    for i, edge in enumerate(roads.edge_ids):
        theirs = read.getEdge(edge)
        assert theirs.getLength() == pytest.approx(roads.length[i], abs=1e-3)
        assert {e.getID() for e in theirs.getOutgoing()} == {roads.edge_ids[j] for j in roads.successors(i)}
        np.testing.assert_allclose(np.array(theirs.getShape())[:, :2], roads.polyline(i)[:, :2], atol=1e-3)


def test_sumo_drives_on_it_and_is_read_back(make_dataset, tmp_path: Path) -> None:
    net, routes, fcd = tmp_path / "n.net.xml", tmp_path / "r.rou.xml", tmp_path / "o.fcd.xml"
    export_dataset(make_dataset(), "sumo-net", net)
    routes.write_text(
        '<routes><vehicle id="v" depart="0"><route edges="r1 r2 r3 r4"/></vehicle>'
        '<vehicle id="w" depart="0"><route edges="diag -r2 -r1"/></vehicle></routes>'
    )
    run(
        "sumo",
        "-n",
        net,
        "-r",
        routes,
        "--fcd-output",
        fcd,
        "--no-step-log",
        "--step-length",
        "0.5",
        "--precision",
        "4",
    )
    wanted = [(float(s.get("time")), v.get("id"), float(v.get("x")), float(v.get("y")), float(v.get("speed")))
              for s in ET.parse(fcd).iter("timestep") for v in s.iter("vehicle")]  # fmt: skip
    assert {w[1] for w in wanted} == {"v", "w"}
    rows = []
    for b in sumo_fcd.IMPORTER.read(fcd, ReadOptions(ReadReport(fcd))):
        names = b.vehicle.strings()
        rows += zip(
            (b.time / 1e6).tolist(), names, *(b.columns[c].tolist() for c in ("x", "y", "speed")), strict=True
        )
    assert rows == wanted


def test_their_tool_reads_the_motion(make_dataset, tmp_path: Path) -> None:
    dataset = make_dataset(vehicles=2)
    fcd, csv = tmp_path / "d.fcd.xml", tmp_path / "d.csv"
    export_dataset(dataset, "sumo-fcd", fcd)
    steps = [float(s.get("time")) for s in ET.parse(fcd).iter("timestep")]
    assert steps == sorted(steps) and len(set(steps)) == len(steps)
    command = [
        sys.executable,
        str(HOME / "tools" / "xml" / "xml2csv.py"),
        str(fcd),
        "-o",
        str(csv),
        "-s",
        ",",
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, env={**os.environ, "SUMO_HOME": str(HOME)}
    )
    assert done.returncode == 0, done.stderr
    lines = csv.read_text().splitlines()
    assert sum("T00" in line for line in lines) == len(dataset.read("T00"))


def test_a_network_that_was_written_is_read_as_it_was(make_dataset, tmp_path: Path) -> None:
    from fleetlog.roads import load_site

    dataset, net = make_dataset(), tmp_path / "square.net.xml"
    export_dataset(dataset, "sumo-net", net)
    before, after = dataset.site.roads(), load_site(net)[0].roads()
    assert set(after.edge_ids) == set(before.edge_ids)
    for i, edge in enumerate(before.edge_ids):
        k = after.edge(edge)
        assert after.length[k] == pytest.approx(before.length[i], abs=0.02)
        assert {after.edge_ids[j] for j in after.successors(k)} == {
            before.edge_ids[j] for j in before.successors(i)
        }
