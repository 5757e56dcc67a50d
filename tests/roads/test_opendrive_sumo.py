"""OpenDRIVE against SUMO's netconvert, a second opinion on lengths and on turns at junctions."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from fleetlog.roads.load import read_map

OPTIONS = (
    "--no-turnarounds --opendrive.internal-shapes --output.original-names --geometry.min-radius.fix false"
)
OPTIONS += " --opendrive.advance-stopline 0 --opendrive.curve-resolution 0.2 --junctions.join false"


def netconvert(path, out):
    program = shutil.which("netconvert") or shutil.which("netconvert", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("SUMO's netconvert (the package eclipse-sumo) is not installed")
    subprocess.run(
        [program, "--opendrive", str(path), "-o", str(out), *OPTIONS.split()], check=True, capture_output=True
    )
    return etree.parse(str(out)).getroot()


def original(net):
    """SUMO's lanes by id: the "road_lane" that each was made of, and its length."""
    lanes = {}
    for lane in net.iterfind("edge/lane"):
        names = [p.get("value") for p in lane.iterfind("param") if p.get("key") == "origId"]
        if names:
            lanes[lane.get("id")] = (names[0], float(lane.get("length")))
    return lanes


def turns_of(net, lanes):
    """Pairs of "road_lane" that follow one another over a junction."""
    pairs = set()
    for c in net.iterfind("connection"):
        if c.get("via") in lanes and not c.get("from").startswith(":"):
            before, after = f"{c.get('from')}_{c.get('fromLane')}", f"{c.get('to')}_{c.get('toLane')}"
            pairs |= {(lanes[before][0], lanes[c.get("via")][0]), (lanes[c.get("via")][0], lanes[after][0])}
    return pairs


def plain(edge_id):
    road, _, lane = edge_id.split(":")
    return f"{road}_{lane}"


def test_lane_lengths_of_fabriksgatan(shared_data, tmp_path):
    path = shared_data / "maps" / "fabriksgatan.xodr"
    theirs = {}
    for name, length in original(netconvert(path, tmp_path / "net.xml")).values():
        theirs[name] = theirs.get(name, 0.0) + length
    ours = {
        plain(e.id): np.linalg.norm(np.diff(e.points, axis=0), axis=1).sum() for e in read_map(path).edges
    }
    assert ours.keys() <= theirs.keys()
    for name, length in ours.items():
        # It writes centimetres; the largest difference seen is 2 cm, on a road of 94 m.
        assert theirs[name] == pytest.approx(length, abs=0.03), name


@pytest.mark.parametrize("name, count", [("fabriksgatan", 24), ("parking_demo", 12)])
def test_turns_over_junctions(shared_data, tmp_path, name, count):
    path = shared_data / "maps" / f"{name}.xodr"
    net = netconvert(path, tmp_path / "net.xml")
    theirs = turns_of(net, original(net))
    junction = {pair[k] for pair in theirs for k in (0, 1)}
    connecting = {r.get("id") for r in etree.parse(str(path)).iterfind("road") if r.get("junction") != "-1"}
    ours = {(plain(a), plain(b)) for a, b in read_map(path).turns}
    over = {p for p in ours if connecting & {p[0].split("_")[0], p[1].split("_")[0]}}
    assert junction and over == {p for p in theirs if connecting & {p[0].split("_")[0], p[1].split("_")[0]}}
    assert len(over) == count
