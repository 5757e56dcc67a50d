"""What calibration may change of a truck, how well it is known beforehand, and what run would tell it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from fleetlog.core.truck import SECTIONS, Truck


@dataclass(frozen=True)
class Unknown:
    """One number of the truck file.

    The prior is normal about the truck file's value with standard deviation ``spread`` (``relative``: a share
    of the value, at least ``floor``), cut off at what a truck file allows.  ``run`` is what to measure where
    it stays unknown.
    """

    key: str
    words: str
    spread: float
    run: str
    relative: bool = False
    floor: float = 0.0

    def deviation(self, truck: Truck) -> float:
        """Standard deviation of the prior, in the parameter's unit."""
        return max(self.spread * truck.value(self.key), self.floor) if self.relative else self.spread

    @property
    def in_file(self) -> Mapping[str, Any]:
        """What a truck file allows: ``unit``, ``low`` and ``high``."""
        section, name = self.key.split(".")
        return next(f.metadata for f in fields(SECTIONS[section]) if f.name == name)

    def bounds(self) -> tuple[float, float]:
        """What a truck file allows."""
        return float(self.in_file["low"]), float(self.in_file["high"])


# Spreads are ours, wide enough for the ranges that type sheets and handbooks give (docs/energy.md).
UNKNOWNS: tuple[Unknown, ...] = (
    Unknown("drive.efficiency", "drive efficiency", 0.08, "a coast-down or a ramp of known grade"),
    Unknown("drive.regeneration", "regeneration", 0.20, "stop-and-go runs beside a coast-down"),
    Unknown("resistance.rolling", "rolling coefficient", 0.35, "a coast-down", True, 0.001),
    Unknown("resistance.drag_area", "drag area", 0.5, "long runs at two speeds above 5 m/s", True, 0.5),
    Unknown("lift.efficiency", "lift efficiency", 0.10, "lifts with half and full load"),
    Unknown("lift.recuperation", "lowering recuperation", 0.20, "lowering runs with full load"),
    Unknown("lift.carriage_mass", "carriage mass", 0.30, "lifts with an empty carriage", True, 10.0),
    Unknown("auxiliary.power", "auxiliary power", 0.50, "ten minutes idle", True, 50.0),
)
