"""Drivers: how fast a path is driven.  They look ahead, limit their jerk, and differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from effects import Effect
from numba import njit
from paths import STEP, Path
from sites import Site
from trucks import Truck

DT = 0.05
"""Seconds a tick."""
JERK = 3.0
SLOWEST = 0.05
"""Creeping speed in the last centimetres [m/s]."""


@dataclass(frozen=True)
class Driver:
    """Shares of the type's numbers that a driver uses."""

    pace: float = 1.0
    up: float = 1.0
    down: float = 1.0
    turn: float = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Driver:
        """Draw a driver."""
        return cls(*(float(1.0 + s * rng.normal()) for s in (0.015, 0.04, 0.06, 0.05)))


@dataclass
class Manner:
    """How one trip is driven: largest speed at every point, accelerations, and stops (point, seconds)."""

    cap: np.ndarray
    up: float
    down: float
    stop: int = -1
    seconds: float = 0.0


def manner(
    site: Site,
    path: Path,
    truck: Truck,
    driver: Driver,
    effects: Sequence[Effect],
    vehicle: int,
    t: float,
    load: float,
) -> Manner:
    """What limits and effects at the begin ``t`` of a trip make of a path."""
    limit = site.layout.limit[path.road] * truck.speed_factor * driver.pace
    lateral, up = np.full(len(limit), truck.lateral), truck.acceleration
    stop, seconds = -1, 0.0
    for e in effects:
        weight, p = e.scope.weight(vehicle, t, path.road), e.parameters
        if e.term == "speed_zone":
            limit = limit * (1.0 + weight * np.isin(path.road, e.roads) * (p["factor"] - 1.0))
        elif e.term == "laden_speed" and load > 0:
            limit = limit * (1.0 + weight * (p["factor"] - 1.0))
        elif e.term == "cornering_speed":
            lateral = lateral + weight * (p["lateral_acceleration"] - truck.lateral)
        elif e.term == "acceleration_limit":
            up = up + float(np.max(weight)) * (p["acceleration"] - truck.acceleration)
        elif e.term == "waiting":
            stop, seconds = _place(path, e), p["seconds"] * float(np.max(weight))
    corner = np.sqrt(lateral * driver.turn / np.maximum(np.abs(path.bend), 1e-4))
    cap = np.maximum(np.minimum(np.minimum(limit, 5.0), corner), 0.4)
    return Manner(
        cap, up * driver.up, truck.deceleration * driver.down, stop if seconds > 0.5 else -1, seconds
    )


def hindered(cap: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Others in the way: now and then a stretch is driven more slowly."""
    cap = cap.copy()
    for _ in range(rng.poisson(len(cap) * STEP / 400.0)):
        at, long = int(rng.integers(len(cap))), int(rng.uniform(50, 200))
        cap[at : at + long] *= rng.uniform(0.6, 0.95)
    return cap


def drive(path: Path, how: Manner) -> tuple[np.ndarray, np.ndarray]:
    """Speed [m/s] and distance along the path [m] at every tick."""
    speed, distance = _advance(how.cap, path.step, how.up, how.down, how.stop, how.seconds)
    return speed, distance


def passed(path: Path, distance: np.ndarray, every: float) -> np.ndarray:
    """Seconds spent in each piece of ``every`` metres; the last, shorter piece is left out."""
    marks = np.arange(0.0, distance[-1], every)
    s = distance + np.arange(len(distance)) * 1e-9
    return np.diff(np.interp(marks, s, np.arange(len(s)) * DT))


def _place(path: Path, e: Effect) -> int:
    on = np.flatnonzero((path.road == e.roads[0]) & (path.sense == e.sense))
    return int(on[int(e.parameters["at"] * len(on))]) if len(on) > 20 else -1


@njit(cache=True)
def _ahead(cap: np.ndarray, step: np.ndarray, down: float, end: int) -> np.ndarray:
    """Largest speed from which every later cap can be met, and a halt at ``end``."""
    out = np.empty(end + 1)
    out[end] = 0.0
    for i in range(end - 1, -1, -1):
        out[i] = min(cap[i], np.sqrt(out[i + 1] ** 2 + 2.0 * down * step[i]))
    return out


@njit(cache=True)
def _advance(
    cap: np.ndarray, step: np.ndarray, up: float, down: float, stop: int, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    size = int(step.sum() / 0.05 / DT / 4.0) + int(seconds / DT) + 4000
    speeds, places = np.zeros(size), np.zeros(size)
    position = np.cumsum(step)
    last = len(cap) - 1
    s, tick = 0.0, 0
    for leg in range(2):
        if leg == 0 and stop < 0:
            continue
        end = stop if leg == 0 else last
        goals = _ahead(cap, step, down, end)
        v, a, i = 0.0, 0.0, 0
        while tick < size - 1:
            while i < end and position[i] < s:
                i += 1
            room = position[end] - s
            if i >= end or room < 0.01 or (room < 0.1 and v <= SLOWEST):
                break
            goal = min(goals[min(int(i + 1 + v * 0.25 / 0.1), end - 1)], 0.9 * np.sqrt(2.0 * down * room))
            wish = min(max((goal - v) / 0.35, -1.25 * down), up)
            a += min(max(wish - a, -JERK * DT), JERK * DT)
            v = max(v + a * DT, SLOWEST)
            s += v * DT
            speeds[tick], places[tick] = v, s
            tick += 1
        if leg == 0:
            for _ in range(int(seconds / DT)):
                if tick < size:
                    places[tick] = s
                    tick += 1
    return speeds[:tick], places[:tick]
