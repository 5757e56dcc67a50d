"""OpenDRIVE against CARLA's own parser: lane centre lines and lane-to-lane successors of every map that it loads."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fleetlog.roads.load import read_map

MAPS = (
    "crest-curve", "curve_r100", "curves_elevation", "e6mini", "e6mini-lht", "fabriksgatan", "malformed_declaration",
    "parking_demo", "straight_500m", "striaghtAndCurves", "two_plus_one",
)  # fmt: skip

# Turns that we have and CARLA has not, with the cause.
OURS_ONLY = {
    # The junction's connecting roads carry both directions and the junction lists them from both of their ends.  CARLA looks
    # up a connection only by a lane's travel into the junction and finds none for these; SUMO finds all of them
    # (test_opendrive_sumo.py).
    "parking_demo": {
        ("2:0:-1", "100:0:-1"), ("2:0:-1", "102:0:-1"), ("3:0:1", "100:0:1"), ("3:0:1", "101:0:-1"),
        ("4:0:1", "101:0:1"), ("4:0:1", "102:0:1"),
    },
}  # fmt: skip


def carla_map(path):
    if importlib.util.find_spec("carla") is None:
        pytest.skip("the package carla is not installed")
    program = Path(__file__).with_name("carla_map.py")
    done = subprocess.run(
        [sys.executable, str(program), str(path)], capture_output=True, text=True, timeout=300, check=False
    )
    if done.returncode:
        pytest.skip(f"CARLA does not load {path.name}: status {done.returncode}")
    # It prints warnings about a missing geoReference before.
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="session", params=[*MAPS, "sample plant"])
def both(request, project_root):
    if request.param == "sample plant":
        path = project_root / "sample_data" / "plant.xodr"
    else:
        path = request.getfixturevalue("shared_data") / "maps" / f"{request.param}.xodr"
    return request.param, read_map(path), carla_map(path)


def off_line(point, line):
    """Horizontal distance of a point from a polyline, and the differences of height and heading there."""
    a, d = line[:-1], np.diff(line, axis=0)
    flat = d[:, :2]
    share = np.clip(
        ((point[:2] - a[:, :2]) * flat).sum(axis=1) / np.maximum((flat**2).sum(axis=1), 1e-18), 0, 1
    )
    foot = a + share[:, None] * d
    gap = np.linalg.norm(foot[:, :2] - point[:2], axis=1)
    k = gap.argmin()
    turn = np.arctan2(d[k, 1], d[k, 0]) - point[3]
    return gap[k], abs(foot[k, 2] - point[2]), abs((turn + np.pi) % (2 * np.pi) - np.pi)


def test_every_waypoint_of_carla_lies_on_our_lane(both):
    name, ours, theirs = both
    edges = {e.id: e for e in ours.edges}
    # CARLA divides by zero on a spiral whose two curvatures are equal (parking_demo has two): no place there to compare with.
    finite = [w for w in theirs["waypoints"] if np.isfinite(w[1:]).all()]
    assert len(finite) == len(theirs["waypoints"]) or name == "parking_demo"
    known = [w for w in finite if w[0] in edges]
    # A lane section shorter than a millimetre is no edge here and still has a waypoint there; CARLA, which goes in steps of
    # 2 m, has none on some lanes shorter than that.
    assert len(finite) - len(known) <= ours.report.dropped.get("shorter than 1 mm", 0)
    assert {n for n, e in edges.items() if np.linalg.norm(e.points[-1] - e.points[0]) > 2.0} <= {
        w[0] for w in known
    }
    assert len(known) > 0.95 * len(theirs["waypoints"])
    gaps = np.array([off_line(np.array(w[1:]), edges[w[0]].points) for w in known])
    assert gaps[:, 0].max() < 0.05
    assert gaps[:, 1].max() < 0.05
    # A polyline has corners where a lane's width jumps (parking bays) or curves tightly.
    assert np.quantile(gaps[:, 2], 0.99) < np.radians(3.5) and gaps[:, 2].max() < np.radians(35)


def contracted(pairs, edges):
    """Pairs of known edges; what passes through unknown (shorter than 1 mm) ones is joined up."""
    after = {}
    for a, b in pairs:
        after.setdefault(a, set()).add(b)
    out = set()
    for a in after.keys() & edges:
        todo, seen = list(after[a]), set()
        while todo:
            b = todo.pop()
            if b in edges:
                out.add((a, b))
            elif b not in seen:
                seen.add(b)
                todo += after.get(b, ())
    return out


def is_own_end(a, b):
    (road, section, _), (other, following, _) = a.split(":"), b.split(":")
    return a == b or (road == other and abs(int(section) - int(following)) == 1)


def test_successors_agree_with_carla(both):
    name, ours, theirs = both
    turns, edges = set(ours.turns), {e.id for e in ours.edges}
    pairs = contracted({tuple(p) for p in theirs["successors"]}, edges)
    leads_on = {a for a, _ in turns}
    # CARLA pairs a lane that leads nowhere with the place at its own end: the same road and lane, the same section or,
    # where s falls on a boundary, the next.
    ends = {(a, b) for a, b in pairs if a not in leads_on and is_own_end(a, b)}
    expected = OURS_ONLY.get(name, set())
    gone = {(a, b) for a, b in pairs if a == b and a in {c for c, _ in expected}}
    assert turns - pairs == expected
    assert pairs - turns - ends - gone == set()
