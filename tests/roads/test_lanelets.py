"""Lanelet2 maps as the library itself writes them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from fleetlog.errors import SiteError
from fleetlog.roads import load_site

ORIGIN = (49.0, 8.0)


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """A one-way lanelet of 30 km/h, one of both directions behind it, and a footway."""
    core = pytest.importorskip("lanelet2.core", reason="the extra lanelet2 is not installed")
    from lanelet2 import io, projection

    def point(x, y):
        return core.Point3d(core.getId(), x, y, 2.0)

    def lanelet(left, right, **tags):
        made = core.Lanelet(
            core.getId(), core.LineString3d(core.getId(), left), core.LineString3d(core.getId(), right)
        )
        for key, value in tags.items():
            made.attributes[key] = value
        return made

    left, right = ([point(x, y) for x in (0, 50, 100)] for y in (2.0, -2.0))
    lanes = core.LaneletMap()
    lanes.add(lanelet(left[:2], right[:2], subtype="road", one_way="yes", speed_limit="30"))
    lanes.add(lanelet(left[1:], right[1:], subtype="road", one_way="no"))
    lanes.add(lanelet([point(0, 9), point(9, 9)], [point(0, 7), point(9, 7)], subtype="walkway"))
    path = tmp_path / "town.osm"
    io.write(str(path), lanes, projection.LocalCartesianProjector(io.Origin(*ORIGIN)))
    return path


def test_lanelets_become_edges_that_follow_one_another(town: Path) -> None:
    site, reports = load_site(town)
    n = site.roads()
    assert len(n) == 3
    assert np.sort(n.length).round(3).tolist() == [50.0, 50.0, 50.0]
    one = next(i for i in range(3) if n.reverse[i] < 0)
    assert n.speed_limit[one] == pytest.approx(30 / 3.6)
    assert np.isnan(np.delete(n.speed_limit, one)).all()
    onward = n.successors(one).tolist()
    assert len(onward) == 1 and n.reverse[onward[0]] >= 0
    assert [(r.format, r.read, r.kept, r.dropped) for r in reports] == [
        ("Lanelet2", 3, 2, {"not for vehicles": 1})
    ]
    assert site.frame is not None
    latitude, longitude = site.frame.to_geographic(*n.position(np.array([one]), np.array([0.0]))[0, :2])
    assert (float(latitude), float(longitude)) == pytest.approx(ORIGIN, abs=1e-7)


def test_without_the_library_the_error_names_the_extra(town: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lanelet2", None)
    with pytest.raises(SiteError, match=r"fleetlog\[lanelet2\]"):
        load_site(town)


def test_a_lanelet_without_its_bounds_is_no_fault_of_the_reader(town: Path) -> None:
    pytest.importorskip("lanelet2")
    town.write_text(town.read_text().replace('role="left"', 'role="other"'))
    with pytest.raises(SiteError, match="no lanelet"):
        load_site(town)
