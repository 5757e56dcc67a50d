"""Shapes [m]: roads, arrows, discs, prisms and trucks as triangles (m, 3, 3); arcs, rings, bolts as lines."""

import itertools
from collections.abc import Sequence

import numpy as np
import rerun as rr

from fleetlog.core.arrays import Floats, Ints
from fleetlog.simulate.track import shifted
from fleetlog.view.palette import Colour

POINTS, DASH = 25, 1.6  # Points of an arc, and length of the dashes of a broken one [m]
RISE, LOWEST, HIGHEST = 0.16, 1.5, 11.0  # Height of an arc over its span, and its bounds [m]
HEAD, SPACING = 1.3, 14.0  # Length of an arrow's head, and between arrows on a road [m]
Painted = tuple[Floats, Colour]  # Triangles (m, 3, 3) [m] of one colour
_FACES = np.array(
    [[0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
     [2, 3, 7], [2, 7, 6], [1, 2, 6], [1, 6, 5], [3, 0, 4], [3, 4, 7]]
)  # fmt: skip
LOAD_CENTRE, LOAD_HALF = (1.9, 0.0, 0.55), (0.55, 0.5, 0.45)  # Of a load's box on the forks [m]


def ribbon(points: Floats, left: float, right: float, lift: float = 0.0) -> Floats:
    """Triangles (2 (n - 1), 3, 3) of the strip from ``left`` to ``right`` metres left of a polyline."""
    up = np.array([0.0, 0.0, lift])
    return _band(shifted(points, right) + up, shifted(points, left) + up)


def _band(a: Floats, b: Floats) -> Floats:
    """Triangles between two polylines (n, 3), seen from the side on which ``b`` is left of ``a``."""
    pairs = [a[:-1], a[1:], b[1:]], [a[:-1], b[1:], b[:-1]]
    return np.concatenate([np.stack(corners, axis=1) for corners in pairs])


def arrows(points: Floats, size: float, lift: float) -> Floats:
    """Chevrons along a polyline, one every ``SPACING`` metres, and one at least from three sizes on."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    run = np.append(0.0, np.cumsum(steps))
    if run[-1] < 3.0 * size:
        return np.zeros((0, 3, 3))
    count = max(1, int(run[-1] / SPACING))
    distance = (np.arange(count) + 0.5) * run[-1] / count
    k = np.clip(np.searchsorted(run, distance, side="right") - 1, 0, len(steps) - 1)
    d = np.diff(points, axis=0)[k] / np.maximum(steps[k], 1e-9)[:, None]
    left = np.column_stack([-d[:, 1], d[:, 0], np.zeros(count)])
    at = points[k] + (distance - run[k])[:, None] * d + np.array([0.0, 0.0, lift])
    tip, notch, back = at + d * size, at - 0.2 * size * d, at - 0.8 * size * d
    a, b = back + 0.6 * size * left, back - 0.6 * size * left
    return np.concatenate([np.stack([tip, a, notch], axis=1), np.stack([tip, notch, b], axis=1)])


def disc(x: float, y: float, radius: float, lift: float, inner: float = 0.0, corners: int = 32) -> Floats:
    """Triangles of a disc on the floor, or of a ring where ``inner`` is positive."""
    angle = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(corners + 1)])
    centre = np.array([x, y, lift])
    return _band(centre + radius * rim, centre + inner * rim)


def triangulate(polygon: Floats) -> Ints:
    """(n - 2, 3) counter-clockwise corners of a polygon (n, 2), by clipping ears; any corner if none is."""
    x, y = np.asarray(polygon, dtype=np.float64).T
    clockwise = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0.0
    left = np.arange(len(x))[:: -1 if clockwise else 1]
    out = []
    while len(left) > 2:
        k = next((k for k in range(len(left)) if _is_ear(polygon[np.roll(left, 1 - k)])), 0)
        out.append(np.roll(left, 1 - k)[:3])
        left = np.delete(left, k)
    return np.array(out, dtype=np.int64).reshape(-1, 3)


def _is_ear(points: Floats) -> bool:
    """Whether the first three of a ring of points turn left, and no other one is in their triangle."""
    corners, others = points[:3], points[3:]
    side = np.roll(corners, -1, axis=0) - corners
    if side[0, 0] * side[1, 1] - side[0, 1] * side[1, 0] <= 0.0:
        return False
    to = others - corners[:, None]
    return not (side[:, None, 0] * to[..., 1] - side[:, None, 1] * to[..., 0] >= 0.0).all(axis=0).any()


def open_ring(polygon: Floats) -> Floats:
    """The polygon (n, 2) without a repeated last vertex."""
    points = np.asarray(polygon, dtype=np.float64)[:, :2]
    return points[:-1] if len(points) > 3 and np.allclose(points[0], points[-1]) else points


def outline(polygon: Floats, z: float) -> Floats:
    """(n + 1, 3) the closed outline of a polygon at height ``z`` [m]."""
    ring = open_ring(polygon)
    return np.column_stack([np.vstack([ring, ring[:1]]), np.full(len(ring) + 1, z)])


def floor_polygon(polygon: Floats, z: float) -> Floats:
    """Triangles of a polygon lying at height ``z``, facing up."""
    return outline(polygon, z)[triangulate(open_ring(polygon))]


def walls(polygon: Floats, low: float, high: float) -> Floats:
    """Triangles of the upright walls over a polygon's outline."""
    return _band(outline(polygon, low), outline(polygon, high))


def arc(start: Floats, end: Floats, points: int = POINTS) -> Floats:
    """(points, 3) from ``start`` to ``end`` ((3,) m), higher in the middle the farther they are apart."""
    share = np.linspace(0.0, 1.0, points)[:, None]
    height = np.clip(RISE * np.hypot(*(end - start)[:2]), LOWEST, HIGHEST)
    line = start + share * (end - start)
    line[:, 2:] += 4.0 * height * share * (1.0 - share)
    return np.asarray(line)


def head(line: Floats) -> Floats:
    """(3, 3) the arrow's head at the end of a line, lying as steep as the line comes down."""
    ahead = line[-1] - line[-2]
    length = float(np.linalg.norm(ahead))
    ahead = ahead / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    side = np.array([-ahead[1], ahead[0], 0.0]) / max(float(np.hypot(ahead[0], ahead[1])), 1e-9)
    back = line[-1] - HEAD * ahead
    return np.stack([back + 0.5 * HEAD * side, line[-1], back - 0.5 * HEAD * side])


def broken(start: Floats, end: Floats) -> list[Floats]:
    """The dashes of an arc; the last one reaches its end."""
    line = arc(start, end, 2 * int(np.clip(np.hypot(*(end - start)[:2]) / (2.0 * DASH), 3, 40)) + 2)
    return [line[k : k + 2] for k in range(0, len(line), 2)]


def ring(radius: float, height: float) -> Floats:
    """(29, 3) a circle about the origin."""
    turn = np.linspace(0.0, 2.0 * np.pi, 29)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(turn), height)])


def bolt(size: float, height: float) -> Floats:
    """(6, 3) a lightning bolt over the origin, leaning so that it is seen from above and from the south."""
    x, y = np.array([[0.1, -0.45, 0.05, -0.1, 0.45, -0.05, 0.1], [1.0, -0.1, -0.05, -1.0, 0.15, 0.1, 1.0]])
    lean = np.sqrt(0.5) * y
    return size * np.column_stack([x, lean, lean]) + [0.0, 0.0, height]


def mesh3d(parts: Sequence[Painted], alpha: int = 255) -> rr.Mesh3D:
    """Triangles as Rerun draws them; ``alpha`` below 255 makes the whole of them translucent."""
    corners = np.concatenate([faces for faces, _ in parts])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = np.array([colour for _, colour in parts], np.uint8)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3), vertex_normals=np.repeat(normals, 3, axis=0),
        triangle_indices=np.arange(corners.size // 3).reshape(-1, 3),
        vertex_colors=np.repeat(colours, [3 * len(faces) for faces, _ in parts], axis=0),
        albedo_factor=None if alpha == 255 else [255, 255, 255, alpha],
    )  # fmt: skip


def box(low: Sequence[float], high: Sequence[float], colour: Colour) -> Painted:
    """An upright box between two corners [m]."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    v = np.array([[x, y, z] for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], float)
    return v[_FACES], colour


def truck_body(colour: Colour) -> list[Painted]:
    """A counterbalance truck, 2.5 m without its forks, about the floor at mid wheelbase, x forward."""
    dark, steel = (38, 40, 46), (120, 126, 136)
    shade = (int(colour[0] * 0.7), int(colour[1] * 0.7), int(colour[2] * 0.7))
    wheels, posts = map(itertools.product, ((-0.7, 0.75), (-0.75, 0.45)), ((-0.5, 0.5), (-0.45, 0.45)))
    return [
        box((-1.25, -0.58, 0.25), (-0.75, 0.58, 1.15), shade),
        box((-0.75, -0.58, 0.25), (1.05, 0.58, 0.85), colour),
        box((-0.45, -0.28, 0.85), (0.05, 0.28, 1.35), dark),
        box((-0.8, -0.5, 2.1), (0.5, 0.5, 2.18), colour),
        box((1.1, -0.36, 2.2), (1.25, 0.36, 2.3), steel),
        *(box((x - 0.28, y - 0.12, 0.0), (x + 0.28, y + 0.12, 0.56), dark) for x, y in wheels),
        *(box((x - 0.04, y - 0.04, 1.0), (x + 0.04, y + 0.04, 2.1), dark) for x, y in posts),
        *(box((1.1, y - 0.06, 0.1), (1.25, y + 0.06, 2.3), steel) for y in (-0.3, 0.3)),
    ]


def truck_fork() -> list[Painted]:
    """Carriage and two forks at height zero, in the truck's own axes."""
    steel = (190, 196, 205)
    tines = [box((1.3, y - 0.07, 0.02), (2.4, y + 0.07, 0.08), steel) for y in (-0.25, 0.25)]
    return [box((1.25, -0.45, 0.02), (1.32, 0.45, 0.6), steel), *tines]
