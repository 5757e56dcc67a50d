"""The trucks of a recording: what their file says, what is true of the type, and what is true of each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Truck:
    """Numbers of a truck file; SI."""

    mass: float
    efficiency: float
    regeneration: float
    rolling: float
    power: float
    """Auxiliary load."""
    drag_area: float = 0.0
    lift: float = 0.65
    carriage: float = 350.0
    speed_factor: float = 0.93
    acceleration: float = 0.6
    deceleration: float = 0.8
    lateral: float = 1.2
    radius: float = 2.5
    voltage: float = 48.0
    capacity: float = 30000.0
    """Watt hours."""

    def own(self, rng: np.random.Generator) -> Truck:
        """One truck of this type: they differ a little."""
        spread = {"mass": 0.008, "rolling": 0.025, "power": 0.03, "efficiency": 0.004}
        return replace(self, **{k: getattr(self, k) * (1.0 + s * rng.normal()) for k, s in spread.items()})

    def write(self, file: Path) -> None:
        """Write a truck file."""
        file.write_text(
            f'name = "blind"\n[chassis]\nmass = {self.mass}\nturn_radius = {self.radius}\n'
            f"[drive]\nefficiency = {self.efficiency}\nregeneration = {self.regeneration}\n"
            f"speed_factor = {self.speed_factor}\nmax_acceleration = {self.acceleration}\n"
            f"max_deceleration = {self.deceleration}\nmax_lateral_acceleration = {self.lateral}\n"
            f"[resistance]\nrolling = {self.rolling}\ndrag_area = {self.drag_area}\n"
            f"[lift]\nefficiency = {self.lift}\ncarriage_mass = {self.carriage}\n"
            f"[auxiliary]\npower = {self.power}\n"
            f"[battery]\nvoltage = {self.voltage}\ncapacity_wh = {self.capacity}\n"
        )


TOLERANCE = {
    "mass": 0.06,
    "rolling": 0.1,
    "efficiency": 0.04,
    "regeneration": 0.15,
    "power": 0.1,
    "lift": 0.06,
}
"""Share by which a truck may differ from its file without that being a finding."""


def truck_type(rng: np.random.Generator) -> Truck:
    """A truck type drawn anew for every recording."""
    return Truck(
        mass=round(rng.uniform(3600, 5400), -1),
        efficiency=round(rng.uniform(0.74, 0.86), 3),
        regeneration=round(rng.uniform(0.2, 0.45), 2),
        rolling=round(rng.uniform(0.011, 0.02), 4),
        power=round(rng.uniform(300, 600), -1),
    )


def misfiled(truth: Truck, wrong: dict[str, float]) -> Truck:
    """The truck file of a type whose numbers are noted wrong by these shares."""
    return replace(truth, **{k: round(getattr(truth, k) * (1.0 + share), 5) for k, share in wrong.items()})
