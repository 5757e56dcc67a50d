"""Effects that a recording may conceal, drawn with strength, place and scope from a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from zlib import crc32

import numpy as np
from sites import Hill, Site
from trucks import Truck

POWER = (
    "grade", "surface_resistance", "rolling_resistance", "aerodynamic_drag", "wind", "cornering_resistance",
    "viscous_drag", "rotational_inertia", "payload", "mass", "drivetrain_efficiency", "regeneration",
    "copper_loss", "lift_efficiency", "auxiliary_load", "enabled_load", "thermal_load",
)  # fmt: skip
CHARGE = ("battery_resistance", "battery_capacity")
SPEED = ("speed_zone", "cornering_speed", "laden_speed", "acceleration_limit", "waiting")
SENSOR = ("clock_offset", "averaging", "speed_scale")
TERMS = (*POWER, *CHARGE, *SPEED, *SENSOR)
PLACED = ("grade", "surface_resistance", "speed_zone", "waiting")
"""Terms that belong to places by themselves."""
FOLLOWS: dict[str, set[str]] = {
    "warm_up": {"time since start", "time", "soc", "ambient_temperature"},
    "hour": {"time", "time since start", "soc", "ambient_temperature"},
    "low_charge": {"soc", "time", "time since start", "ambient_temperature"},
    "laden_fast": {"payload", "speed"},
    "odd_vehicle": {"vehicle_id"},
    "slow_drag": {"speed", "acceleration"},
    "cross_heading": {"heading"},
}
"""Effects that no term of the vocabulary describes, and the variables that each follows."""
OUTSIDE = tuple(FOLLOWS)
ACCEPTED = {"odd_vehicle": ("rolling_resistance", "surface_resistance")}
"""Names that say the same of an effect outside of the vocabulary when their scope is right."""


@dataclass(frozen=True)
class Scope:
    """Whom an effect touches, where and since when [s from the begin of the recording]."""

    vehicles: tuple[int, ...] | None = None
    begin: float | None = None
    end: float | None = None
    drift: bool = False
    """Grows evenly from ``begin`` to ``end`` instead of being there at once."""
    roads: tuple[int, ...] | None = None

    def weight(self, vehicle: int, t: Any, road: Any = None) -> Any:
        """Share of the full effect at times ``t`` on ``road``; arrays or numbers."""
        if self.vehicles is not None and vehicle not in self.vehicles:
            return 0.0 * t
        begin, end = self.begin or 0.0, np.inf if self.end is None else self.end
        weight = np.clip((t - begin) / (end - begin), 0.0, 1.0) if self.drift else (t >= begin) & (t < end)
        return weight * (1.0 if self.roads is None or road is None else np.isin(road, self.roads))


@dataclass(frozen=True)
class Effect:
    """A term with its true parameters; ``roads`` it lies on where it has places."""

    term: str
    parameters: dict[str, float]
    roads: tuple[int, ...] = ()
    sense: int = 0
    scope: Scope = field(default_factory=Scope)

    @property
    def channel(self) -> str:
        """Where it shows."""
        if self.term == "speed_scale":
            return "distance"
        if self.term in SPEED:
            return "speed"
        return "soc" if self.term in CHARGE else "battery_power"

    def hill(self) -> Hill:
        """The hill of a ``grade``."""
        p = self.parameters
        return Hill(p["x"], p["y"], p["height"], p["width"])


@dataclass
class Draw:
    """What the sizes of effects are drawn from; ``sign`` forces the direction of those that have two."""

    site: Site
    truck: Truck
    strength: float
    rng: np.random.Generator
    sign: float

    def u(self, low: float, high: float) -> float:
        """Uniform number."""
        return float(self.rng.uniform(low, high))

    def by(self, low: float, high: float) -> float:
        """Uniform number times the strength."""
        return self.strength * self.u(low, high)

    def either(self, up: float, down: float) -> float:
        """One plus or minus a share times the strength."""
        return 1.0 + self.strength * (up if self.sign > 0 else -down)


def draw(
    term: str,
    site: Site,
    truck: Truck,
    strength: float,
    seed: int,
    *,
    sign: float = 0.0,
    roads: tuple[int, ...] = (),
    scope: Scope | None = None,
) -> Effect:
    """Draw one effect; the same for a seed whatever else the recording conceals."""
    rng = np.random.default_rng([seed, 1, crc32(term.encode())])
    d = Draw(site, truck, strength, rng, sign or float(rng.choice([-1.0, 1.0])))
    scope = scope or Scope()
    if term in PLACED:
        return _placed(term, d, roads, scope)
    parameters = {k: float(v) for k, v in _SIZES[term](d).items()}
    if term == "odd_vehicle":
        scope = Scope(vehicles=(0,))
    return Effect(
        term, parameters, roads, 0, Scope(scope.vehicles, scope.begin, scope.end, scope.drift, roads or None)
    )


def _placed(term: str, d: Draw, roads: tuple[int, ...], scope: Scope) -> Effect:
    if term == "grade":
        return _hill(d, roads, scope)
    if term == "waiting":
        road = roads[0] if roads else d.site.central(4)[int(d.rng.integers(4))]
        return Effect(term, {"at": d.u(0.35, 0.65), "seconds": d.by(9, 22)}, (road,), 1, scope)
    roads = roads or _stretch(d)
    factor = 1.0 + d.by(0.7, 1.8) if term == "surface_resistance" else max(1.0 - d.by(0.3, 0.5), 0.3)
    return Effect(term, {"factor": factor}, roads, 0, scope)


def _hill(d: Draw, roads: tuple[int, ...], scope: Scope) -> Effect:
    at = roads[0] if roads else d.site.central(8)[int(d.rng.integers(8))]
    x, y = d.site.line(at, 3)[1] + d.rng.uniform(-8, 8, 2)
    p = {"x": float(x), "y": float(y), "height": d.by(1.0, 2.4), "width": d.u(22, 34)}
    return Effect("grade", p | {"max_grade": d.site.steepest(Hill(**p))}, roads, 0, scope)


def _stretch(d: Draw) -> tuple[int, ...]:
    """One to three roads that touch."""
    start = int(d.rng.integers(d.site.roads))
    more = d.rng.permutation(d.site.touching(start))[: int(d.rng.integers(0, 3))]
    return tuple(sorted({start, *map(int, more)}))


def _wind(d: Draw) -> dict[str, float]:
    """Speeds scale with the root of the strength: the force is mostly that of its square."""
    speed, angle = d.strength**0.5 * d.u(5, 9), d.u(0, 2 * np.pi)
    return {"wind_east": speed * np.cos(angle), "wind_north": speed * np.sin(angle)}


_SIZES: dict[str, Callable[[Draw], dict[str, float]]] = {
    "rolling_resistance": lambda d: {"coefficient": d.truck.rolling * d.either(d.u(0.3, 0.7), 0.35)},
    "aerodynamic_drag": lambda d: {"drag_area": d.truck.drag_area + d.by(8, 14)},
    "wind": _wind,
    "cornering_resistance": lambda d: {"k": d.by(0.06, 0.16)},
    "viscous_drag": lambda d: {"coefficient": d.by(90, 200)},
    "rotational_inertia": lambda d: {"factor": 1.0 + d.by(0.14, 0.3)},
    "payload": lambda d: {"factor": d.either(d.u(0.3, 0.6), d.u(0.3, 0.5))},
    "mass": lambda d: {"mass": d.truck.mass * d.either(d.u(0.14, 0.3), d.u(0.14, 0.25))},
    "drivetrain_efficiency": lambda d: {"efficiency": d.truck.efficiency * (1.0 - d.by(0.08, 0.16))},
    "regeneration": lambda d: {
        "regeneration": d.truck.regeneration
        + d.strength * (d.u(0.15, 0.3) if d.sign > 0 else -0.6 * d.truck.regeneration)
    },
    "copper_loss": lambda d: {"coefficient": d.by(1.2e-4, 3e-4)},
    "lift_efficiency": lambda d: {"efficiency": d.truck.lift * (1.0 - d.by(0.3, 0.5))},
    "auxiliary_load": lambda d: {
        "power": d.truck.power + d.strength * (d.u(180, 450) if d.sign > 0 else -0.5 * d.truck.power)
    },
    "enabled_load": lambda d: {"power": d.by(200, 450), "seconds": d.u(4, 20)},
    "thermal_load": lambda d: {"heating": d.by(30, 70), "threshold": d.u(8, 16)},
    "battery_resistance": lambda d: {"resistance": d.by(0.012, 0.03)},
    "battery_capacity": lambda d: {"capacity": d.truck.capacity * (1.0 - d.by(0.12, 0.3))},
    "cornering_speed": lambda d: {"lateral_acceleration": d.truck.lateral * (1.0 - d.by(0.5, 0.7))},
    "laden_speed": lambda d: {"factor": 1.0 - d.by(0.2, 0.4)},
    "acceleration_limit": lambda d: {"acceleration": d.truck.acceleration * (1.0 - d.by(0.35, 0.55))},
    "clock_offset": lambda d: {"offset": d.sign * d.by(0.9, 4.0)},
    "averaging": lambda d: {"interval": 1.0 + d.by(4.0, 9.0)},
    "speed_scale": lambda d: {"factor": 1.0 + d.sign * d.by(0.03, 0.08)},
    "warm_up": lambda d: {"share": d.by(0.5, 0.9), "minutes": d.u(15, 35)},
    "hour": lambda d: {"power": d.by(500, 900), "from": d.u(0.5, 1.2), "hours": d.u(0.6, 1.2)},
    "low_charge": lambda d: {"share": d.by(0.7, 1.2)},
    "laden_fast": lambda d: {"power": d.by(2500, 4500)},
    "odd_vehicle": lambda d: {"force": d.by(250, 450)},
    "slow_drag": lambda d: {"force": d.by(500, 900), "below": d.u(1.6, 2.2)},
    "cross_heading": lambda d: {"force": d.by(250, 450), "angle": d.u(0, np.pi)},
}  # fmt: skip
