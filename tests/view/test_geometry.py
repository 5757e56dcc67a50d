"""Ribbons, polygons and the fitted eye, against closed formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.simulate.track import shifted, stretch
from fleetlog.view import ribbons
from fleetlog.view.blueprint import FIELD_OF_VIEW, fitted


def area(triangles: np.ndarray) -> np.ndarray:
    """Signed area of every triangle seen from above."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0


def shoelace(ring: np.ndarray) -> float:
    n = np.roll(ring, -1, axis=0)
    return abs(float((ring[:, 0] * n[:, 1] - n[:, 0] * ring[:, 1]).sum())) / 2.0


@st.composite
def stars(draw: st.DrawFn) -> np.ndarray:
    """Simple polygons with notches, in either direction round."""
    n = draw(st.integers(4, 24))
    radius = np.array(draw(st.lists(st.floats(2.0, 20.0), min_size=n, max_size=n)))
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return ring[::-1] if draw(st.booleans()) else ring


@given(stars(), st.booleans())
def test_triangles_of_a_polygon_fill_it_and_face_up(ring: np.ndarray, closed: bool) -> None:
    polygon = np.vstack([ring, ring[:1]]) if closed else ring
    triangles = ribbons.floor_polygon(polygon, 3.0)
    assert len(triangles) == len(ring) - 2 and (triangles[:, :, 2] == 3.0).all()
    assert (area(triangles) >= -1e-9).all()
    assert area(triangles).sum() == pytest.approx(shoelace(ring))


@given(stars(), st.floats(0.5, 12.0))
def test_walls_have_the_area_of_the_outline_by_the_height(ring: np.ndarray, height: float) -> None:
    t = ribbons.walls(ring, 0.0, height)
    total = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() / 2.0
    assert total == pytest.approx(height * np.linalg.norm(ring - np.roll(ring, -1, axis=0), axis=1).sum())


@given(st.lists(st.floats(-0.6, 0.6), min_size=2, max_size=12), st.floats(-3, 3), st.floats(0.2, 4))
def test_ribbon_has_its_width(turns: list[float], right: float, width: float) -> None:
    """Its area is the mean of the lengths of its two rims by the width, exactly so on a line of gentle bends about its middle."""
    heading = np.cumsum(turns)
    steps = 8.0 * np.column_stack([np.cos(heading), np.sin(heading), 0 * heading])
    line = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    triangles = ribbons.ribbon(line, right + width, right)
    assert (area(triangles) > 0).all()
    rims = [np.linalg.norm(np.diff(shifted(line, o), axis=0), axis=1).sum() for o in (right + width, right)]
    assert area(triangles).sum() == pytest.approx(width * np.mean(rims), rel=1e-6)


@given(st.floats(0, 30), st.floats(0, 30))
def test_stretch_is_the_part_asked_for(a: float, b: float) -> None:
    line = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [10, 10, 10]], float)
    part = stretch(line, min(a, b), max(a, b))
    length = np.linalg.norm(np.diff(part, axis=0), axis=1).sum()
    assert length == pytest.approx(max(a, b) - min(a, b), abs=2e-3)


def test_arrows_point_along_the_road() -> None:
    line = np.array([[0, 0, 0], [40, 30, 0]], float)
    triangles = ribbons.arrows(line, 1.0, 0.0)
    tips, backs = triangles[:, 0], triangles[:, 1:].mean(axis=1)
    along = (tips - backs) @ np.array([0.8, 0.6, 0.0])
    assert len(triangles) == 2 * 3 and (along > 0).all()
    assert (area(triangles) > 0).all(), "seen from above"


def test_faces_of_a_box_look_outward() -> None:
    faces, _ = ribbons.box((-1, -2, 0), (1, 2, 3), (9, 9, 9))
    centres = faces.mean(axis=1) - np.array([0, 0, 1.5])
    mesh = ribbons.mesh3d([(faces, (9, 9, 9))])
    normals = np.array(mesh.vertex_normals.as_arrow_array().to_pylist())
    assert ((normals[::3] * centres).sum(axis=1) > 0).all()


def test_truck_is_as_large_as_a_truck() -> None:
    parts = [*ribbons.truck_body((1, 2, 3)), *ribbons.truck_fork()]
    vertices = np.concatenate([faces.reshape(-1, 3) for faces, _ in parts])
    size = np.ptp(vertices, axis=0)
    assert 3.2 < size[0] < 4.0 and 1.0 < size[1] < 1.4 and 2.0 < size[2] < 2.5
    assert vertices[:, 2].min() == 0.0


@given(
    st.floats(5, 2000),
    st.floats(5, 2000),
    st.floats(0, 30),
    st.floats(0, 1.5),
    st.floats(0.4, 1.5),
    st.floats(0.8, 3.0),
)
def test_eye_sees_everything_and_not_much_more(
    width: float, depth: float, height: float, azimuth: float, elevation: float, aspect: float
) -> None:
    outline = np.array([[x, y, z] for x in (0, width) for y in (100, 100 + depth) for z in (0, height)])
    eye, target = (np.array(p) for p in fitted(outline, azimuth, elevation, aspect))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.cross(right, forward)
    p = outline - eye
    ahead = p @ forward
    tall = np.tan(FIELD_OF_VIEW / 2)
    across, above = (p @ right) / ahead / (tall * aspect), (p @ up) / ahead / tall
    assert (ahead > 0).all() and np.abs(across).max() <= 1.02 and np.abs(above).max() <= 1.02
    if min(width, depth) > 50:
        assert max(np.ptp(across), np.ptp(above)) > 0.6
