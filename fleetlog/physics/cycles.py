"""Motions by recipe: the runs of a test protocol and the VDI 2198 cycle, as a driver would drive them.

Every recipe is a list of pieces of constant acceleration; :func:`legs` lays them on a time axis of step
``dt``, each sample in the middle of its step: sums over them are exact to second order in ``dt``."""

from collections.abc import Callable
from dataclasses import astuple, dataclass

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck

VDI_LEGS = (22.0, 8.0, 22.0, 8.0)
"""Lengths of the four legs [m]: forward and reverse runs between two points some 30 m apart.  Our reading of
the summary of VDI 2198 (30 m, 2 m, 60 cycles an hour); the exact table of the standard is not public."""
VDI_LIFT = 1.7  # Height of each of the two lifts [m]: from the travel height of 0.3 m to 2 m
VDI_SPEED = 3.0  # Travelling speed that makes 60 cycles an hour [m/s]; our reading too
VDI_PERIOD = 60.0  # Of one cycle [s]


@dataclass(frozen=True)
class Piece:
    """``duration`` s from ``speed`` m/s at ``acceleration`` m/s2, lifting at ``lift_speed`` m/s."""

    duration: float
    speed: float = 0.0
    acceleration: float = 0.0
    lift_speed: float = 0.0


def legs(pieces: list[Piece], payload: float = 0.0, grade: float = 0.0, dt: float = 0.1) -> Motion:
    """The pieces as one motion with ``payload`` [kg] on a road of slope ``grade`` (tan theta)."""
    if not (pieces := [p for p in pieces if p.duration > 0.0]):
        return Motion.of(0)
    duration, speed, acceleration, lift_speed = np.array([astuple(p) for p in pieces]).T
    count = np.maximum(np.ceil(duration / dt), 1.0).astype(int)
    piece = np.repeat(np.arange(len(pieces)), count)
    since = (np.arange(len(piece)) - (np.cumsum(count) - count)[piece] + 0.5) * (duration / count)[piece]
    begin = np.append(0.0, np.cumsum(duration)[:-1])[piece]
    moving = ((speed > 0.0) | (acceleration > 0.0))[piece]
    return Motion.of(
        len(piece), time=begin + since, dt=(duration / count)[piece],
        speed=np.maximum(speed[piece] + acceleration[piece] * since, 0.0) * moving,
        acceleration=acceleration[piece] * moving, slope=np.arctan(grade), payload=payload,
        lift_speed=lift_speed[piece],
    )  # fmt: skip


def run(length: float, speed: float, up: float, down: float) -> list[Piece]:
    """Rest to rest over ``length`` m at up to ``speed`` m/s, gathered at ``up``, shed at ``down`` m/s2."""
    top = min(speed, float(np.sqrt(2.0 * length * up * down / (up + down))))
    cruise = max(length - top**2 / 2.0 * (1.0 / up + 1.0 / down), 0.0)
    return [Piece(top / up, 0.0, up), Piece(cruise / top, top), Piece(top / down, top, -down)]


def lift(height: float, truck: Truck) -> list[Piece]:
    """Up by ``height`` m and down again."""
    up, down = truck.lift.raise_speed, truck.lift.lower_speed
    return [Piece(height / up, lift_speed=up), Piece(height / down, lift_speed=-down)]


def vdi_pieces(truck: Truck, speed: float = VDI_SPEED) -> list[Piece]:
    """The VDI 2198 cycle: two lifts, four legs, the rest of the minute standing."""
    up, down = truck.drive.max_acceleration, truck.drive.max_deceleration
    pieces: list[Piece] = []
    for i, length in enumerate(VDI_LEGS):
        pieces += lift(VDI_LIFT, truck) if i % 2 == 0 else []
        pieces += run(length, speed, up, down)
    return [*pieces, Piece(VDI_PERIOD - sum(p.duration for p in pieces))]


def vdi2198(truck: Truck) -> Motion:
    """One VDI 2198 cycle with the rated load."""
    return legs(vdi_pieces(truck), truck.chassis.rated_load)


CYCLES: dict[str, Callable[[Truck], Motion]] = {"vdi2198": vdi2198}
"""Cycles that ``fleetlog simulate --cycle`` makes, by name."""
