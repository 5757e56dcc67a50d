"""The path of a matched log: its coordinate, and its curvature from the map with corners rounded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
ROUNDING = 2.5
"""Radius with which a truck takes a corner of the map [m], as a nominal truck does."""
MOST_ALONG = 10.0
"""A position farther than this along the edge from its place there does not correct the place [m]."""


@dataclass(frozen=True)
class MapPath:
    """(N,) each: way travelled along the edges [m], the way that the positions show (NaN off the map), heading and slope [rad]."""

    way: Floats
    seen: Floats
    heading: Floats
    slope: Floats


def map_path(
    network: Network, edge: Index, offset: Floats, x: Floats, y: Floats, link: NDArray[np.uint8]
) -> MapPath:
    """The path of matched rows; marks jumps in ``link``.

    Offsets are smoothed already by the matching; what a position says beyond them is added back, so that the noise is that
    of the positions again.
    """
    from fleetlog.physics.smooth.kernels import path_coordinate
    from fleetlog.physics.smooth.rows.kernels import on_edges

    way, along, heading, slope = (np.zeros(len(edge)) for _ in range(4))
    path_coordinate(
        edge, offset, x, y, network.next_first, network.next_edges, network.length, network.reverse, 5.0, link, way,
    )  # fmt: skip
    on_edges(edge, offset, x, y, network.points, network.first, network.distance, along, heading, slope)
    along[np.abs(along) > MOST_ALONG] = 0.0
    return MapPath(way, np.where(edge >= 0, way + along, np.nan), heading, slope)


def map_curvature(network: Network, edge: Index, offset: Floats, way: Floats) -> Floats:
    """(N,) mean curvature [1/m, left positive] of the way that each row stands for; 0 off the map.

    Every bend of the map is taken as an arc of radius ``ROUNDING`` and its angle spread over that arc, so the angles of
    a drive add up to those of the map whatever the sampling.
    """
    on = edge >= 0
    if on.sum() < 2:
        return np.zeros(len(edge))
    turned = _turned_angle(*_bends(network, edge, offset, way))
    middle = 0.5 * (way[1:] + way[:-1])
    low, high = np.append(way[:1], middle), np.append(middle, way[-1:])
    # where the truck hardly moves: the curvature of the place itself
    half = np.maximum(0.5 * (high - low), 0.25)
    centre = 0.5 * (high + low)
    mean = (turned(centre + half) - turned(centre - half)) / (2.0 * half)
    return np.where(on, mean, 0.0)


def _bends(network: Network, edge: Index, offset: Floats, way: Floats) -> tuple[Floats, Floats, Floats]:
    """Coordinate [m], angle [rad] and half arc length [m] of every bend that the rows pass: in the edges and between them."""
    enter = np.flatnonzero(np.diff(edge, prepend=-2) != 0)
    enter = enter[edge[enter] >= 0]
    origin = way[enter] - offset[enter]  # coordinate of the start of the edge, on this visit
    e = edge[enter]
    inner = np.maximum(network.first[e + 1] - network.first[e] - 2, 0)
    visit = np.repeat(np.arange(len(e)), inner)
    k = network.first[e][visit] + 1 + np.arange(len(visit)) - np.repeat(np.cumsum(inner) - inner, inner)
    p = network.points
    angle = _between(p[k] - p[k - 1], p[k + 1] - p[k])
    where = origin[visit] + network.distance[k]
    near = 0.5 * np.minimum(
        network.distance[k] - network.distance[k - 1], network.distance[k + 1] - network.distance[k]
    )
    last, begin = network.first[e + 1] - 1, network.first[e]
    joins = (
        np.flatnonzero((np.diff(enter) > 0) & (edge[enter[1:] - 1] >= 0))
        if len(enter) > 1
        else np.zeros(0, int)
    )
    turn = _between((p[last] - p[last - 1])[joins], (p[begin + 1] - p[begin])[joins + 1])
    # a truck that comes back on the same road has turned round on the spot: no bend
    turn = np.where(np.abs(turn) > 3.0, 0.0, turn)
    where = np.concatenate([where, origin[joins + 1]])
    angle = np.concatenate([angle, turn])
    half = np.maximum(np.concatenate([near, np.zeros(len(joins))]), 0.5 * ROUNDING * np.abs(angle))
    seen = np.abs(angle) > 1e-9
    return where[seen], angle[seen], np.maximum(half[seen], 0.05)


def _between(a: Floats, b: Floats) -> Floats:
    """Angle from direction a to direction b, (n,), left positive."""
    return np.asarray(
        np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])
    )


def _turned_angle(where: Floats, angle: Floats, half: Floats) -> Callable[[Floats], Floats]:
    """Angle turned up to a coordinate, as a function: piecewise linear, each bend over its arc."""
    if not len(where):
        return np.zeros_like
    knots = np.concatenate([where - half, where + half])
    rates = np.concatenate([angle / (2.0 * half), -angle / (2.0 * half)])
    order = np.argsort(knots, kind="stable")
    knots, rate = knots[order], np.cumsum(rates[order])
    total = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(knots))])
    return lambda s: np.asarray(np.interp(s, knots, total))
