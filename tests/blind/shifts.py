"""What one truck does on one day: trips with and without a load, lifting after each, charging at times."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from driving import Driver, drive, hindered, manner, passed
from paths import Path, path
from power import HZ, Motion
from world import World

CHARGER = 6000.0
"""Watts."""
PIECE = 12.0
"""Metres over which travel times are compared."""
Piece = dict[str, np.ndarray]
STILL = ("v", "bend", "lift", "height", "charge")
"""What is zero where a truck stands."""


@dataclass
class Legs:
    """Travel times of pieces of road: as driven, and by a nominal driver under a choice of effects."""

    vehicle: int
    driven: list[np.ndarray] = field(default_factory=list)
    nominal: dict[str, list[np.ndarray]] = field(default_factory=dict)
    """By the name of the effect left out; ``""`` none, ``*`` all."""


@dataclass
class Trip:
    """One way through the site with a load."""

    way: Path
    load: float
    begin: float


def shift(w: World, vehicle: int, day: int, rng: np.random.Generator) -> tuple[Motion, Legs]:
    """Motion of one truck at every tick, and the travel times of its trips."""
    driver, legs = Driver.draw(rng), Legs(vehicle)
    begin = 86400.0 * day + float(rng.uniform(0, 240))
    junctions = len(w.site.layout.xy)
    place, loaded, ticks = int(rng.integers(junctions)), False, 0
    to_charge = float(rng.uniform(0.3, 0.7)) * 3600.0
    pieces: list[Piece] = []
    while ticks < w.case.hours * 3600.0 * HZ:
        goal = int(rng.integers(junctions))
        route = w.site.route(place, goal, rng) if goal != place else []
        if not route:
            continue
        load = float(rng.uniform(300, 2400)) if loaded else 0.0
        done = _drive(w, Trip(path(w.site, route), load, begin + ticks / HZ), driver, legs, rng)
        done = [done, _lift(done, rng)]
        if w.logger.charging and ticks > to_charge * HZ:
            done.append(_charge(done[-1], w.logger.charging))
            to_charge += 3600.0
        pieces += done
        ticks += sum(len(p["v"]) for p in done)
        place, loaded = goal, not loaded if rng.random() < 0.9 else loaded
    return _in_time(w, {k: np.concatenate([p[k] for p in pieces]) for k in pieces[0]}, begin, day, rng), legs


def _drive(w: World, trip: Trip, driver: Driver, legs: Legs, rng: np.random.Generator) -> Piece:
    how = manner(w.site, trip.way, w.truck, driver, w.effects, legs.vehicle, trip.begin, trip.load)
    how.cap = hindered(how.cap, rng)
    v, s = drive(trip.way, how)
    _compare(w, trip, s, legs)
    at = np.cumsum(trip.way.step)
    index = np.clip(np.searchsorted(at, s), 0, len(at) - 1)
    out = {k: np.interp(s, at, getattr(trip.way, k)) for k in ("x", "y", "heading", "bend")}
    out |= {k: getattr(trip.way, k)[index] for k in ("road", "sense")}
    weighed = max(trip.load * (1 + 0.03 * rng.normal()), 0.0)
    n = len(v)
    out |= {k: np.zeros(n) for k in ("lift", "height", "charge")}
    return out | {"v": v, "load": np.full(n, trip.load), "weighed": np.full(n, weighed)}


def _compare(w: World, trip: Trip, s: np.ndarray, legs: Legs) -> None:
    """Note the travel times of a trip beside those of a nominal driver, with and without each effect."""
    legs.driven.append(passed(trip.way, s, PIECE))
    on_speed = [e for e in w.effects if e.channel == "speed"]
    choices = {"": on_speed, "*": []} | {e.term: [o for o in on_speed if o is not e] for e in on_speed}
    for name, effects in choices.items() if on_speed else [("", [])]:
        how = manner(w.site, trip.way, w.truck, Driver(), effects, legs.vehicle, trip.begin, trip.load)
        times = passed(trip.way, drive(trip.way, how)[1], PIECE)
        legs.nominal.setdefault(name, []).append(times)


def _stand(before: Piece, ticks: int) -> Piece:
    """Nothing but time passes."""
    return {k: np.full(ticks, 0.0 if k in STILL else values[-1]) for k, values in before.items()}


def _lift(before: Piece, rng: np.random.Generator) -> Piece:
    """The stop after a trip."""
    rate = lifting(0, rng)
    out = _stand(before, len(rate))
    return out | {"lift": rate, "height": np.maximum(np.cumsum(rate) / HZ, 0.0)}


def lifting(ticks: int, rng: np.random.Generator) -> np.ndarray:
    """Vertical speed of the forks: up, a pause, down; within ``ticks`` where that is more than none."""
    height = float(rng.uniform(0.3, 3.4))
    rest = [int(rng.uniform(4, 15) * HZ) for _ in range(3)]
    if ticks:
        rest = [max(ticks // 8, 1)] * 3
        height = min(height, 0.18 * (ticks - sum(rest)) / HZ)
    up, down = np.full(int(height / 0.35 * HZ), 0.35), np.full(int(height / 0.45 * HZ), -0.45)
    return np.concatenate([np.zeros(rest[0]), up, np.zeros(rest[1]), down, np.zeros(rest[2])])


def _charge(before: Piece, how: str) -> Piece:
    """Twenty minutes at a charger, or two for a fresh battery, which one value that is no number marks."""
    out = _stand(before, (120 if how == "swap" else 1200) * HZ)
    out["charge"][60 * HZ :] = 0.0 if how == "swap" else CHARGER
    if how == "swap":
        out["charge"][60 * HZ] = np.nan
    return out


def _in_time(w: World, whole: Piece, begin: float, day: int, rng: np.random.Generator) -> Motion:
    clock = np.arange(len(whole["v"])) / HZ
    warmer = float(rng.uniform(-4.0, 12.0)) if day else 0.0
    since = clock + begin % 86400.0
    temperature = warmer - 1.0 + 2.6 * since / 3600.0 + 0.2 * np.sin(clock / 700.0)
    hill = w.site.hill
    slope = (
        np.sin(np.arctan(hill.slope(whole["x"], whole["y"], whole["heading"])))
        if hill
        else np.zeros(len(clock))
    )
    kept = {k: v for k, v in whole.items() if k != "sense"}
    return Motion(t=begin + clock, temperature=temperature, slope=slope, **kept)
