"""NURBS trajectories of VDA 5050 and LIF as polylines (Piegl and Tiller, The NURBS Book, 1997)."""

from typing import Any

import numpy as np

from fleetlog.errors import SiteError
from fleetlog.roads.formats._odr_geometry import sample
from fleetlog.roads.formats.base import Floats, number

LEAST = 1e-6
"""Smallest weight of a control point."""
APART = 1e-9
"""Smallest distance of two different knots, as a share of all."""


def nurbs(raw: Any, tolerance: float) -> Floats:
    """(n, 2) vertices [m] of {degree, knotVector, controlPoints}; chords within ``tolerance`` [m].

    Without a degree it is 1; a control point without a weight weighs 1.
    """
    again = "export it again"
    if not isinstance(raw, dict) or not isinstance(raw.get("controlPoints"), list):
        raise SiteError("its trajectory has no controlPoints", do=again)
    if not all(isinstance(p, dict) for p in raw["controlPoints"]):
        raise SiteError("a control point is no object", do=again)
    if not isinstance(raw.get("knotVector") or [], list):
        raise SiteError("its knotVector is no list", do=again)
    degree = int(number(raw.get("degree", 1), "degree"))
    knots = np.array([number(k, "knotVector") for k in raw.get("knotVector") or []])
    named = ({"weight": 1.0, **p} for p in raw["controlPoints"])
    rows = [[number(p.get(key), "controlPoints") for key in ("x", "y", "weight")] for p in named]
    weighted = np.array(rows).reshape(-1, 3)
    if bool((weighted[:, 2] < LEAST).any()):
        raise SiteError(f"a weight is below {LEAST:g}", do=again)
    short = not 1 <= degree < len(weighted)
    if short or len(knots) != len(weighted) + degree + 1 or bool((np.diff(knots) < 0).any()):
        raise SiteError(
            f"its trajectory of degree {degree} has {len(knots)} knots for {len(weighted)} control points",
            do="there must be points + degree + 1 knots in rising order",
        )
    gaps = np.diff(knots)
    if knots[degree] == knots[len(weighted)]:
        raise SiteError("its knots leave no curve", do=again)
    if bool(((gaps > 0.0) & (gaps < APART * np.ptp(knots))).any()):
        raise SiteError("two of its knots nearly coincide", do=again)
    return _polyline(degree, knots, weighted, tolerance)


def _polyline(degree: int, knots: Floats, weighted: Floats, tolerance: float) -> Floats:
    from scipy.interpolate import BSpline

    homogeneous = np.column_stack([weighted[:, :2] * weighted[:, 2:], weighted[:, 2]])
    spline = BSpline(knots, homogeneous, degree)

    def at(u: Floats) -> Floats:
        p = spline(u)
        return np.column_stack([p[:, :2] / p[:, 2:], np.zeros(len(u))])

    spans = np.unique(knots[degree : len(knots) - degree])
    return at(sample(at, spans, tolerance))[:, :2]
