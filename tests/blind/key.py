"""The key of a recording: what is concealed, where, in whom, since when, and what could be known of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import oracle
from effects import ACCEPTED, FOLLOWS, Effect
from loggers import ALLOWED
from observe import Seen
from shifts import Legs
from world import World

START = np.datetime64("2026-04-13T06:00:00", "ms")


def time(t: float) -> str:
    """ISO 8601 of seconds from the begin of a recording."""
    return f"{START + np.timedelta64(int(t * 1000), 'ms')}Z"


def key_of(w: World, seen: Sequence[Seen], legs: Sequence[Legs], rows: int) -> dict[str, Any]:
    """JSON-ready key."""
    errors = oracle.channels(seen, legs)
    outside = any(e.term in FOLLOWS for e in w.effects)
    return {
        "case": w.case.name,
        "family": w.case.family,
        "seed": w.case.seed,
        "site": w.case.site,
        "logger": w.case.logger,
        "vehicles": w.case.vehicles,
        "rows": rows,
        "start": time(0.0),
        "seconds": w.seconds,
        "verdict": "unknown" if outside else "found" if w.effects else "none",
        "terms": [e.term for e in w.effects],
        "allowed": list(ALLOWED.get(w.case.logger, ())),
        "effects": [_effect(w, e, errors) for e in w.effects],
        "adjustments": _adjustments(w),
        "channels": {k: {"before": v.get("*", v[""]), "floor": v[""]} for k, v in errors.items()},
    }


def _effect(w: World, e: Effect, errors: dict[str, dict[str, float]]) -> dict[str, Any]:
    s = e.scope
    places = e.roads or s.roads or ()
    return {
        "term": e.term,
        "parameters": e.parameters,
        "roads": w.site.names(list(places)) if e.term != "grade" else [],
        "extent": _extent(w, e, places),
        "follows": sorted(FOLLOWS.get(e.term, ())),
        "accept": [*ACCEPTED.get(e.term, ()), *(["surface_resistance"] if s.roads else [])],
        "scope": {
            "vehicles": None if s.vehicles is None else [f"T{k + 1}" for k in s.vehicles],
            "from": None if s.begin is None or s.drift else time(s.begin),
            "until": None if s.end is None or s.drift else time(s.end),
            "drift": s.drift,
        },
        "oracle": oracle.share(e, errors),
    }


def _extent(w: World, e: Effect, roads: tuple[int, ...]) -> list[float] | None:
    """Box [m] of the roads, or of the hill."""
    if e.term == "grade":
        h = e.hill()
        return [h.x - 1.5 * h.width, h.y - 1.5 * h.width, h.x + 1.5 * h.width, h.y + 1.5 * h.width]
    if not roads:
        return None
    points = np.vstack([w.site.line(k) for k in roads])
    return [*map(float, points.min(axis=0)), *map(float, points.max(axis=0))]


def _adjustments(w: World) -> list[dict[str, Any]]:
    """Numbers of the truck file that are wrong within their tolerances."""
    changed = [k for k, v in vars(w.file).items() if v != getattr(w.truck, k)]
    return [{"name": k, "value": getattr(w.truck, k), "file": getattr(w.file, k)} for k in changed]
