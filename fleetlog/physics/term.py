"""What a physics term is: a function of motion, truck and its own parameters, the same signature for all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck

Floats = NDArray[np.float64]
Values = Mapping[str, float | Floats]
"""A parameter's value by name: a number, or (N,) where a field was looked up along the motion."""

Function = Callable[[Motion, Truck, Values], Floats]

GRAVITY = 9.81
"""Standard acceleration of free fall, rounded as the nominal model states it [m/s2]."""
AIR_DENSITY = 1.2
"""Of the air at 20 degC and 1013 hPa, rounded as the nominal model states it [kg/m3]."""


@dataclass(frozen=True)
class Parameter:
    """A number of a term.

    ``neutral`` is the value at which the term changes nothing; where ``truck_key`` is given it is the nominal truck's own
    value instead (``drive.efficiency``).  ``low`` and ``high`` bound what is physically plausible.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float = 0.0
    truck_key: str | None = None

    def nominal(self, truck: Truck) -> float:
        """The value in the nominal model."""
        return truck.value(self.truck_key) if self.truck_key else self.neutral


@dataclass(frozen=True)
class Term:
    """One effect.

    ``acts`` says what ``function`` returns, (N,):

    =========  ==========================================================================================
    force      N at the wheel against the motion, > 0 resisting; goes through drive efficiency or regeneration
    power      W at the battery terminals, > 0 consuming
    load       the payload that acts, kg (replaces the recorded one)
    truck      nothing of its own: it only changes values of the truck (``truck_key`` of its parameters)
    loss       an internal loss that only the state of charge sees, W; ``motion.power`` is that at the terminals
    speed      the highest speed that this effect allows, m/s (inf where it allows any), ``motion.speed`` being what road
               and truck allow; no function where it acts on the motion otherwise (truck values, standing still)
    sensor     what the log shows of the channel in place of the truth; a fault of the recording, not of the vehicle
    =========  ==========================================================================================

    ``nominal`` terms belong to the nominal model.  A ``field`` term's first parameter may vary over the road network:
    its values come per stretch of directed edge; ``odd`` if the two directions of a road have opposite values (slope),
    else they share one.
    """

    name: str
    acts: Literal["force", "power", "load", "truck", "loss", "speed", "sensor"]
    statement: str
    """What it is, for a fleet engineer; a clause without a full stop."""
    parameters: tuple[Parameter, ...] = ()
    function: Function | None = None
    nominal: bool = False
    field: bool = False
    odd: bool = False
    depends_on: tuple[str, ...] = ()
    """The state variables that a mismatch follows where this term is missing."""

    @cached_property
    def by_name(self) -> dict[str, Parameter]:
        """Parameters by name."""
        return {p.name: p for p in self.parameters}


def total_mass(motion: Motion, truck: Truck) -> Floats:
    """(N,) truck and load [kg]."""
    return truck.chassis.mass + motion.payload
