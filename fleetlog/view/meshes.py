"""Small triangle meshes built in code, flat shaded: every face owns its vertices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fleetlog.view.palette import Colour


@dataclass(frozen=True)
class Mesh:
    """``vertices`` (n, 3) m, ``triangles`` (m, 3) indices, ``normals`` (n, 3), ``colours`` (n, 3) uint8."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    normals: NDArray[np.float32]
    colours: NDArray[np.uint8]


def mesh_of(triangles: ArrayLike, colours: ArrayLike) -> Mesh:
    """From (m, 3, 3) corner positions and one colour, or one a triangle ((m, 3) uint8)."""
    corners = np.asarray(triangles, dtype=np.float64).reshape(-1, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    tint = np.broadcast_to(np.asarray(colours, np.uint8), (len(corners), 3))
    return Mesh(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3),
        np.repeat(normal, 3, axis=0).astype(np.float32),
        np.repeat(tint, 3, axis=0),
    )


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    shift = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    triangles = [m.triangles + np.uint32(s) for m, s in zip(meshes, shift, strict=True)]
    vertices, normals, colours = (
        np.concatenate([getattr(m, part) for m in meshes]) for part in ("vertices", "normals", "colours")
    )
    return Mesh(vertices, np.concatenate(triangles), normals, colours)


_FACES = np.array(
    [[0, 3, 2], [0, 2, 1], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
     [2, 3, 7], [2, 7, 6], [1, 2, 6], [1, 6, 5], [3, 0, 4], [3, 4, 7]]
)  # fmt: skip


def box(low: Sequence[float], high: Sequence[float], colour: Colour) -> Mesh:
    """An upright box between two corners [m]."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    v = np.array([[x, y, z] for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])
    return mesh_of(v[_FACES], colour)


def truck_body(colour: Colour) -> Mesh:
    """A counterbalance truck about 2.5 m long without its forks;
    the origin on the floor at mid wheelbase, x forward.
    """
    dark, steel = (38, 40, 46), (120, 126, 136)
    shade = (int(colour[0] * 0.7), int(colour[1] * 0.7), int(colour[2] * 0.7))
    wheels = [
        box((x - 0.28, side - 0.12, 0.0), (x + 0.28, side + 0.12, 0.56), dark)
        for x in (-0.7, 0.75)
        for side in (-0.5, 0.5)
    ]
    posts = [
        box((x - 0.04, y - 0.04, 1.0), (x + 0.04, y + 0.04, 2.1), dark)
        for x in (-0.75, 0.45)
        for y in (-0.45, 0.45)
    ]
    mast = [box((1.1, y - 0.06, 0.1), (1.25, y + 0.06, 2.3), steel) for y in (-0.3, 0.3)]
    return join([
        box((-1.25, -0.58, 0.25), (-0.75, 0.58, 1.15), shade),
        box((-0.75, -0.58, 0.25), (1.05, 0.58, 0.85), colour),
        box((-0.45, -0.28, 0.85), (0.05, 0.28, 1.35), dark),
        box((-0.8, -0.5, 2.1), (0.5, 0.5, 2.18), colour),
        box((1.1, -0.36, 2.2), (1.25, 0.36, 2.3), steel),
        *wheels, *posts, *mast,
    ])  # fmt: skip


def truck_fork() -> Mesh:
    """Carriage and two forks at height zero, in the truck's own axes."""
    steel = (190, 196, 205)
    tines = [box((1.3, y - 0.07, 0.02), (2.4, y + 0.07, 0.08), steel) for y in (-0.25, 0.25)]
    return join([box((1.25, -0.45, 0.02), (1.32, 0.45, 0.6), steel), *tines])


LOAD_CENTRE, LOAD_HALF = (1.9, 0.0, 0.55), (0.55, 0.5, 0.45)
"""The box of a load on the forks: centre and half sizes [m]."""
