"""The force balance of the recorded trucks, in which effects shift coefficients.

Nothing of fleetlog is used here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from effects import Effect
from trucks import Truck

HZ = 20
"""Ticks a second."""
GRAVITY, AIR = 9.81, 1.2
BASELINE = {
    "inertia": 1.0, "payload": 1.0, "scrub": 0.0, "viscous": 0.0, "force": 0.0, "slope": 0.0, "east": 0.0,
    "north": 0.0, "copper": 0.0, "factor": 1.0, "load": 0.0, "ohm": 0.0,
}  # fmt: skip
"""Coefficients that a truck file does not have."""


@dataclass
class Motion:
    """What one truck did at every tick; arrays of equal length."""

    t: np.ndarray
    """Seconds since the begin of the recording."""
    v: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    bend: np.ndarray
    road: np.ndarray
    slope: np.ndarray
    """That the map knows."""
    load: np.ndarray
    weighed: np.ndarray
    lift: np.ndarray
    """Vertical speed of the forks."""
    height: np.ndarray
    temperature: np.ndarray
    charge: np.ndarray
    """Charging power at the battery [W]; not a number at the moment of a swap."""

    def __len__(self) -> int:
        return len(self.t)


def balance(
    m: Motion,
    truck: Truck,
    effects: Sequence[Effect],
    vehicle: int,
    kind: Truck | None = None,
    *,
    weighed: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """(terminal, cell) power at every tick [W] without charging; ``weighed``: with the loads that a log has.

    A truck keeps its deviation from its ``kind`` (itself by default), from whose numbers effects were drawn.
    """
    c = coefficients(m, truck, effects, vehicle, kind)
    load = (m.weighed if weighed else m.load) * c["payload"]
    mass = c["mass"] + load
    moving = m.v > 0.0
    force = mass * np.gradient(m.v) * HZ * c["inertia"]
    normal = mass * GRAVITY * moving
    force += normal * (c["rolling"] + c["scrub"] * np.abs(m.bend)) + mass * GRAVITY * (m.slope + c["slope"])
    air = m.v - c["east"] * np.cos(m.heading) - c["north"] * np.sin(m.heading)
    force += 0.5 * AIR * c["drag_area"] * air * np.abs(air) + c["viscous"] * m.v + c["force"] * moving
    wheel = force * m.v
    drive = np.where(wheel > 0, wheel / c["efficiency"] * c["factor"], wheel * c["regeneration"])
    drive += c["copper"] * force**2 * moving
    return supplied(m, c, load, drive)


def supplied(
    m: Motion, c: dict[str, Any], load: np.ndarray, drive: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(terminal, cell) power at every tick [W] that the drive, the hydraulics and all else take."""
    lifting = (load + c["carriage"]) * GRAVITY * np.maximum(m.lift, 0.0) / c["lift"]
    terminal = drive + lifting + c["power"] + c["load"]
    return terminal, terminal + c["ohm"] * (terminal / c["voltage"]) ** 2


def coefficients(
    m: Motion, truck: Truck, effects: Sequence[Effect], vehicle: int, kind: Truck | None = None
) -> dict[str, Any]:
    """What effects make of a truck's numbers: one number each, or one at every tick."""
    c: dict[str, Any] = BASELINE | vars(truck) | {"kind": BASELINE | vars(kind or truck)}
    for effect in effects:
        if effect.term in _SHIFTS:
            weight = effect.scope.weight(vehicle, m.t, m.road)
            _SHIFTS[effect.term](c, effect, weight, m)
    return c


def capacity(m: Motion, truck: Truck, effects: Sequence[Effect], vehicle: int) -> Any:
    """Watt hours that the state of charge is counted by."""
    full: Any = truck.capacity
    for e in effects:
        if e.term == "battery_capacity":
            full = full + e.scope.weight(vehicle, m.t) * (e.parameters["capacity"] - truck.capacity)
    return full


Shift = Callable[[dict[str, Any], Effect, Any, Motion], None]


def _toward(name: str, parameter: str = "") -> Shift:
    """The coefficient moves to the number of the effect."""

    def shift(c: dict[str, Any], e: Effect, weight: Any, _: Motion) -> None:
        kind = c["kind"][name]
        own = c[name] / kind if kind else 1.0
        c[name] = c[name] + weight * own * (e.parameters[parameter or name] - kind)

    return shift


def _times(name: str) -> Shift:
    def shift(c: dict[str, Any], e: Effect, weight: Any, m: Motion) -> None:
        c[name] = c[name] * (1.0 + weight * np.isin(m.road, e.roads) * (e.parameters["factor"] - 1.0))

    return shift


def _adds(name: str, share: Callable[[Effect, Motion], Any]) -> Shift:
    def shift(c: dict[str, Any], e: Effect, weight: Any, m: Motion) -> None:
        c[name] = c[name] + weight * share(e, m)

    return shift


def _enabled(e: Effect, m: Motion) -> np.ndarray:
    """Watts while moving and some seconds after."""
    at = np.arange(len(m))
    last = np.maximum.accumulate(np.where(m.v > 0, at, -HZ * 10**6))
    return e.parameters["power"] * (at - last <= e.parameters["seconds"] * HZ)


def _hour(e: Effect, m: Motion) -> np.ndarray:
    h = m.t % 86400.0 / 3600.0 - e.parameters["from"]
    return e.parameters["power"] * ((h > 0) & (h < e.parameters["hours"]))


def _heating(e: Effect, m: Motion) -> np.ndarray:
    return e.parameters["heating"] * np.maximum(e.parameters["threshold"] - m.temperature, 0.0)


def _warming(c: dict[str, Any], e: Effect, weight: Any, m: Motion) -> None:
    since = (m.t - m.t[0]) / 60.0
    c["rolling"] = c["rolling"] * (
        1.0 + weight * e.parameters["share"] * np.exp(-since / e.parameters["minutes"])
    )


def _draining(c: dict[str, Any], e: Effect, weight: Any, m: Motion) -> None:
    since = (m.t - m.t[0]) / max(m.t[-1] - m.t[0], 1.0)
    c["factor"] = c["factor"] + weight * e.parameters["share"] * since**2


def _rushing(e: Effect, m: Motion) -> np.ndarray:
    return e.parameters["power"] * (m.load > 800) * np.clip(m.v - 2.2, 0, 1.5)


def _blowing(c: dict[str, Any], e: Effect, weight: Any, m: Motion) -> None:
    for name in ("east", "north"):
        _toward(name, f"wind_{name}")(c, e, weight, m)


def _crossing(e: Effect, m: Motion) -> np.ndarray:
    return e.parameters["force"] * np.cos(2.0 * (m.heading - e.parameters["angle"]))


_SHIFTS: dict[str, Shift] = {
    "rolling_resistance": _toward("rolling", "coefficient"),
    "aerodynamic_drag": _toward("drag_area"),
    "mass": _toward("mass"),
    "payload": _toward("payload", "factor"),
    "rotational_inertia": _toward("inertia", "factor"),
    "drivetrain_efficiency": _toward("efficiency"),
    "regeneration": _toward("regeneration"),
    "lift_efficiency": _toward("lift", "efficiency"),
    "auxiliary_load": _toward("power"),
    "battery_resistance": _toward("ohm", "resistance"),
    "copper_loss": _toward("copper", "coefficient"),
    "cornering_resistance": _toward("scrub", "k"),
    "viscous_drag": _toward("viscous", "coefficient"),
    "surface_resistance": _times("rolling"),
    "grade": _adds("slope", lambda e, m: np.sin(np.arctan(e.hill().slope(m.x, m.y, m.heading)))),
    "wind": _blowing,
    "thermal_load": _adds("load", _heating),
    "enabled_load": _adds("load", _enabled),
    "hour": _adds("load", _hour),
    "laden_fast": _adds("load", _rushing),
    "odd_vehicle": _adds("force", lambda e, m: e.parameters["force"]),
    "slow_drag": _adds("force", lambda e, m: e.parameters["force"] * (m.v < e.parameters["below"])),
    "cross_heading": _adds("force", _crossing),
    "warm_up": _warming,
    "low_charge": _draining,
}  # fmt: skip
