"""Small triangle meshes built in code, flat shaded: every face owns its vertices."""

import itertools
from collections.abc import Sequence

import numpy as np
import rerun as rr

from fleetlog.core.trajectory import Floats
from fleetlog.view.palette import Colour

Painted = tuple[Floats, Colour]  # Triangles (m, 3, 3) [m] of one colour


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


_FACES = np.array(
    [[0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
     [2, 3, 7], [2, 7, 6], [1, 2, 6], [1, 6, 5], [3, 0, 4], [3, 4, 7]]
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


LOAD_CENTRE, LOAD_HALF = (1.9, 0.0, 0.55), (0.55, 0.5, 0.45)
"""The box of a load on the forks: centre and half sizes [m]."""
