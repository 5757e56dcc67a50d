"""Effects that a recording may conceal, drawn with strength and place from a seed."""

from __future__ import annotations

from typing import Any

import numpy as np
from plants import Plant

POWER = (
    "grade", "surface_resistance", "rolling_resistance", "aerodynamic_drag", "wind", "cornering_resistance", "viscous_drag",
    "rotational_inertia", "payload", "drivetrain_efficiency", "regeneration", "lift_efficiency", "auxiliary_load", "thermal_load",
    "battery_resistance",
)  # fmt: skip
SPEED = ("speed_zone", "cornering_speed", "laden_speed", "acceleration_limit", "waiting")
SENSOR = ("clock_offset", "speed_scale")
TERMS = (*POWER, *SPEED, *SENSOR)
OUTSIDE = ("warm_up", "hour", "low_charge", "laden_fast", "odd_vehicle")
"""Effects that no term of the vocabulary describes, and the variable that each follows."""
FOLLOWS = {
    "warm_up": {"time since start", "time", "soc", "ambient_temperature"}, "hour": {"time", "time since start", "soc", "ambient_temperature"},
    "low_charge": {"soc", "time", "time since start", "ambient_temperature"}, "laden_fast": {"payload", "speed"}, "odd_vehicle": {"vehicle_id"},
}  # fmt: skip


def truck(rng: np.random.Generator) -> dict[str, float]:
    """A truck file's numbers, drawn anew for every recording."""
    return {
        "mass": round(rng.uniform(3600, 5400), -1), "efficiency": round(rng.uniform(0.74, 0.86), 3), "regeneration": round(rng.uniform(0.2, 0.45), 2),
        "rolling": round(rng.uniform(0.011, 0.02), 4), "drag_area": 0.0, "power": round(rng.uniform(300, 600), -1), "lift": 0.65, "carriage": 350.0,
        "factor": 0.93, "acceleration": 0.6, "deceleration": 0.8, "lateral": 1.2, "radius": 2.5, "voltage": 48.0, "capacity": 30000.0,
    }  # fmt: skip


def draw(
    name: str, plant: Plant, nominal: dict[str, float], strength: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Parameters of one effect; the true values of what a diagnosis should name are under the term's own parameter names."""

    def u(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def off(low: float, high: float) -> float:
        return 1.0 + strength * u(low, high)

    sign = float(rng.choice([-1.0, 1.0]))
    middle = plant.xy.mean(axis=0) + rng.uniform(-55, 55, 2) * [1.0, 0.6]
    if name == "grade":
        return {
            "x": float(middle[0]),
            "y": float(middle[1]),
            "height": strength * u(1.0, 2.4),
            "width": u(22, 34),
        }
    if name in ("surface_resistance", "speed_zone"):
        start = int(rng.integers(len(plant.ends)))
        touching = [
            k for k in range(len(plant.ends)) if k != start and set(plant.ends[k]) & set(plant.ends[start])
        ]
        roads = [start, *[int(k) for k in rng.permutation(touching)[: int(rng.integers(0, 3))]]]
        factor = off(0.7, 1.8) if name == "surface_resistance" else max(1.0 - strength * u(0.3, 0.5), 0.3)
        return {"roads": sorted(roads), "factor": factor}
    if name == "waiting":
        busy = np.argsort(np.hypot(*(plant.xy[plant.ends].mean(axis=1) - plant.xy.mean(axis=0)).T))
        road, sense = int(busy[rng.integers(4)]), 1
        return {"road": road, "sense": sense, "at": u(0.35, 0.65), "seconds": strength * u(9, 22)}
    table = {
        "rolling_resistance": {"coefficient": nominal["rolling"] * (off(0.3, 0.7) if sign > 0 else 1.0 - 0.35 * strength)},
        "aerodynamic_drag": {"drag_area": strength * u(8, 14)},
        "wind": {"speed": u(5, 9), "angle": u(0, 2 * np.pi)},
        "cornering_resistance": {"k": strength * u(0.06, 0.16)},
        "viscous_drag": {"coefficient": strength * u(90, 200)},
        "rotational_inertia": {"factor": off(0.14, 0.3)},
        "payload": {"factor": off(0.3, 0.6) if sign > 0 else 1.0 - strength * u(0.3, 0.5)},
        "drivetrain_efficiency": {"efficiency": nominal["efficiency"] * (1.0 - strength * u(0.08, 0.16))},
        "regeneration": {"regeneration": nominal["regeneration"] + strength * (u(0.15, 0.3) if sign > 0 else -0.6 * nominal["regeneration"])},
        "lift_efficiency": {"efficiency": 0.65 * (1.0 - strength * u(0.3, 0.5))},
        "auxiliary_load": {"power": nominal["power"] + strength * u(180, 450)},
        "thermal_load": {"heating": strength * u(30, 70), "threshold": u(8, 16)},
        "battery_resistance": {"resistance": strength * u(0.012, 0.03)},
        "cornering_speed": {"lateral_acceleration": nominal["lateral"] * (1.0 - strength * u(0.5, 0.7))},
        "laden_speed": {"factor": 1.0 - strength * u(0.2, 0.4)},
        "acceleration_limit": {"acceleration": nominal["acceleration"] * (1.0 - strength * u(0.35, 0.55))},
        "clock_offset": {"offset": sign * strength * u(0.9, 4.0)},
        "speed_scale": {"factor": 1.0 + sign * strength * u(0.03, 0.08)},
        "warm_up": {"share": strength * u(0.5, 0.9), "minutes": u(15, 35)},
        "hour": {"power": strength * u(500, 900), "from": u(0.5, 1.2), "hours": u(0.6, 1.2)},
        "low_charge": {"share": strength * u(0.7, 1.2)},
        "laden_fast": {"power": strength * u(2500, 4500)},
        "odd_vehicle": {"vehicle": 0, "force": strength * u(250, 450)},
    }  # fmt: skip
    return table[name]
