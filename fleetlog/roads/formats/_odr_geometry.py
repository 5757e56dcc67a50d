"""OpenDRIVE reference lines by arc length.  Source: ASAM OpenDRIVE 1.8, chapter 9."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.legendre import leggauss

from fleetlog.core.arrays import Floats, Indices
from fleetlog.core.network import distance_to_segment
from fleetlog.errors import SiteError

Curve = Callable[[Floats], tuple[Floats, Floats, Floats]]
"""ds [m] along a piece to u, v [m] and heading [rad] in the piece's own axes."""

_NODES, _WEIGHTS = (leggauss(12) + np.array([[1.0], [0.0]])) / 2.0  # from 0 to 1
_TABLE = 513
MOST = 200_000  # vertices of one line


def spiral(start: float, end: float, length: float) -> Curve:
    """Curvature [1/m], left positive, linear in s from ``start`` to ``end``; equal ones are an arc, 0 a line.

    The heading h = k0 s + (k1 - k0) s^2 / (2 L) is integrated.

    Gauss-Legendre with 12 nodes on panels of less than 1 rad: exact to 1e-12 of the length for all
    curvatures, where Fresnel integrals lose digits as k1 approaches k0."""
    rate = (end - start) / length
    panels = 1 + math.ceil(max(abs(start), abs(end)) * length)

    def curve(ds: Floats) -> tuple[Floats, Floats, Floats]:
        share = (np.arange(panels)[:, None] + _NODES).ravel() / panels
        weight, s = np.tile(_WEIGHTS, panels) / panels, ds[:, None] * share
        h = start * s + rate * s * s / 2.0
        return ds * (np.cos(h) @ weight), ds * (np.sin(h) @ weight), start * ds + rate * ds * ds / 2.0

    return curve


def param_poly3(u: Floats, v: Floats, length: float, span: float) -> Curve:
    """u(p), v(p) cubic (coefficients (4,) a to d), p from 0 to ``span``; ds is arc length. p is not
    proportional to the arc length; a table of the arc length over p is inverted, stretched so that the end of
    the piece is that of the curve where the declared ``length`` differs by a little."""
    pu, pv = Polynomial(u), Polynomial(v)
    du, dv = pu.deriv(), pv.deriv()
    grid = np.linspace(0.0, span, _TABLE)
    passed = _arc_length(grid, du, dv)

    def curve(ds: Floats) -> tuple[Floats, Floats, Floats]:
        p = np.interp(ds * (passed[-1] / length), passed, grid)
        return pu(p), pv(p), np.arctan2(dv(p), du(p))

    return curve


def poly3(v: Floats, length: float) -> Curve:
    """v(u) cubic (coefficients (4,) a to d), u along the start heading, found from the arc length."""
    grid = np.linspace(0.0, length, _TABLE)
    passed = _arc_length(grid, Polynomial([1.0]), Polynomial(v).deriv())
    # The curve is at least as long as u, so u stays within the length.
    return param_poly3(np.array([0.0, 1.0, 0.0, 0.0]), v, length, float(np.interp(length, passed, grid)))


def _arc_length(grid: Floats, du: Polynomial, dv: Polynomial) -> Floats:
    """Arc length at every grid value: Gauss-Legendre within each cell, summed."""
    step = np.diff(grid)
    p = grid[:-1, None] + step[:, None] * _NODES
    return np.concatenate([[0.0], np.cumsum((np.hypot(du(p), dv(p)) @ _WEIGHTS) * step)])


class Piece(NamedTuple):
    """One geometry record: where it starts, and its curve."""

    s: float
    x: float
    y: float
    heading: float
    length: float
    curve: Curve


class Plan(NamedTuple):
    """The reference line of a road seen from above."""

    pieces: tuple[Piece, ...]

    @property
    def starts(self) -> Floats:
        """s [m] at the start of every piece."""
        return np.array([p.s for p in self.pieces], dtype=np.float64)

    def at(self, s: Floats) -> Floats:
        """(3, N) x, y [m] and heading [rad] at s (N,) [m]; beyond a piece's length its end counts."""
        out, which = np.empty((3, len(s))), _record(self.starts, s)
        for k in np.unique(which):
            rows, piece = which == k, self.pieces[k]
            u, v, turn = piece.curve(np.clip(s[rows] - piece.s, 0.0, piece.length))
            c, d = math.cos(piece.heading), math.sin(piece.heading)
            out[:, rows] = piece.x + c * u - d * v, piece.y + d * u + c * v, piece.heading + turn
        return out


class Cubics(NamedTuple):
    """A quantity given by records a + b ds + c ds^2 + d ds^3, each from its own s to the next one's."""

    starts: Floats
    coefficients: Floats  # (n, 4)

    def at(self, s: Floats) -> Floats:
        """(N,) values at s [m]; 0 without records; before the first record its first value."""
        if not len(self.starts):
            return np.zeros_like(s)
        k = _record(self.starts, s)
        ds = np.maximum(s - self.starts[k], 0.0)
        a, b, c, d = self.coefficients[k].T
        return np.asarray(a + ds * (b + ds * (c + ds * d)), dtype=np.float64)


def _record(starts: Floats, s: Floats) -> Indices:
    """(N,) the last record that starts at or before each s; the first before all."""
    return np.maximum(np.searchsorted(starts, s, side="right") - 1, 0)


def sample(points: Callable[[Floats], Floats], stations: Floats, tolerance: float) -> Floats:
    """Stations s [m] so dense that chords stay within ``tolerance`` [m] of a curve, ``points`` (N, 3).
    Between the given stations the curve is smooth. Every chord is compared with the curve at its quarters and
    halved until they agree, at most 14 times. :class:`SiteError` beyond ``MOST`` stations."""
    s = stations
    for _ in range(14):
        low, step, ends = s[:-1], np.diff(s), points(s)
        between = (points(low + share * step) for share in (0.25, 0.5, 0.75))
        gaps = [distance_to_segment(inner, ends[:-1], ends[1:]) for inner in between]
        if not (coarse := np.max(gaps, axis=0) > tolerance).any():
            break
        if len(s) > MOST:
            raise SiteError(f"one line of it needs more than {MOST:,} vertices", do="correct the map")
        s = np.sort(np.concatenate([s, (low + step / 2.0)[coarse]]))
    return s
