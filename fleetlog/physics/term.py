"""What a physics term is: a function of motion, truck and its own parameters, the same signature for all;
and all that the file of a term imports."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from fleetlog.core.arrays import Floats
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck

__all__ = ["AIR_DENSITY", "GRAVITY", "Floats", "Motion", "Parameter", "Term", "Truck", "Values", "total_mass"]

Values = Mapping[str, float | Floats]
"""A parameter's value by name: a number, or (N,) where a field was looked up along the motion."""

Function = Callable[[Motion, Truck, Values], Floats]

GRAVITY = 9.81  # Standard acceleration of free fall, rounded as the nominal model states it [m/s2]
ALIKE = 0.5  # Trucks of a fleet differ by this share of the tolerance of the truck file
AIR_DENSITY = 1.2  # Of the air at 20 degC and 1013 hPa, rounded as the nominal model states it [kg/m3]


@dataclass(frozen=True)
class Parameter:
    """A number of a term."""

    name: str
    unit: str
    low: float  # Bounds of what is physically plausible; no estimate is reported on one
    high: float
    ends: bool = False  # Trucks may have just the lower bound, none at all: who does is no implausible one
    neutral: float = 0.0  # At which the term changes nothing; that of ``truck_key`` where it has one
    truck_key: str | None = None  # The truck's value that it replaces, as ``drive.efficiency``
    tolerance: float = 0.0
    """How far a truck file or a logger may be off without being wrong (95 %): a share of the truck's value,
    or in the parameter's unit where there is none.  0: any deviation is a finding."""
    between: float = 0.0  # The same of one vehicle beside the others of its fleet, where it is more than half
    inverse: bool = False  # The model is linear in the inverse of the number, as in that of an efficiency
    shape: bool = False  # It only gives the effect its shape (a threshold): scanned, no effect by itself
    bounds: str | None = None  # State variable that the number is a threshold of
    usual: float = 1.0
    """How far values of a field usually are apart from place to place, in its coordinate (:meth:`scaled`)."""
    ceiling: bool = False  # The nominal value is what is allowed; a larger one is a habit, not a finding
    added: bool = False  # The difference from the nominal value is reported beside the value
    reach: float = 0.0
    """A limit acts only once it is so far below the nominal value; its slope there is taken over that."""
    sentence: str = ""  # The finding in one sentence where this number is what was found, not the term's

    def nominal(self, truck: Truck) -> float:
        """Return the value in the nominal model."""
        return truck.value(self.truck_key) if self.truck_key else self.neutral

    def allowance(self, truck: Truck, between: bool = False) -> float:
        """Return the tolerance in the parameter's unit, or how far one vehicle may be from its fleet."""
        share = max(self.between, ALIKE * self.tolerance) if between else self.tolerance
        return share * (abs(truck.value(self.truck_key)) if self.truck_key else 1.0)

    def scaled(self, value: float) -> float:
        """Return the coordinate in which the model is linear."""
        return 1.0 / value if self.inverse else value

    @property
    def plausible(self) -> tuple[float, float]:
        """How far the coordinate may be from where the term changes nothing."""
        low, high = sorted(self.scaled(v) - self.scaled(self.neutral) for v in (self.low, self.high))
        return low, high

    @cached_property
    def edges(self) -> tuple[float, float]:
        """How far a model may turn it: beyond the bounds as far as truck files, and trucks, may be off."""
        off = (1.0 + ALIKE) * self.tolerance
        low, high = (off * (abs(bound) if self.truck_key else 1.0) for bound in (self.low, self.high))
        return self.low - low, self.high + high

    @property
    def caps(self) -> bool:
        """Whether it acts on one side of where it changes nothing only: below the speed that is allowed."""
        return self.ceiling and not self.truck_key

    def value_of(self, scaled: float) -> float:
        """Return the value at a coordinate of :meth:`scaled`, within the :attr:`edges`."""
        low, high = self.edges
        if self.inverse:
            return high if scaled <= 1.0 / high else max(1.0 / scaled, low)
        return min(max(scaled, low), high)


@dataclass(frozen=True)
class Term:
    """One effect.

    ``acts`` says what ``function`` returns, (N,):

    =========  ==========================================================================================
    force      N at the wheel against the motion, > 0 resisting; goes through drive efficiency or regeneration
    power      W at the battery terminals, > 0 consuming
    drive      the same, by the sum of all forces at the wheel: the values have it as ``force``, (N,) newtons
    load       the payload that acts, kg (replaces the recorded one)
    truck      nothing of its own: it only changes values of the truck (``truck_key`` of its parameters)
    loss       nothing of its own: the same, for a loss inside the battery that only the state of charge sees
    speed      the highest speed that this effect allows, m/s (inf: any), ``motion.speed`` being
               what road and truck allow; no function where it only changes values of the truck
    wait       nothing of its own: its first parameter is the time that every passage stands still, s
    traffic    nothing of its own: time lost while other vehicles were in the way, as their positions show
    sensor     nothing of its own: a fault of the recording, not of the vehicle
    =========  =========================================================================================="""

    name: str
    acts: Literal["force", "power", "drive", "load", "truck", "loss", "speed", "wait", "traffic", "sensor"]
    statement: str  # What it is, for a fleet engineer; a clause without a full stop
    parameters: tuple[Parameter, ...] = ()
    function: Function | None = None
    law: str = ""  # What it says where it has no function, whose docstring says it otherwise
    cause: str = ""  # What its energy is spent on, in a breakdown; empty: its name
    nominal: bool = False  # It belongs to the nominal model
    field: bool = False
    """Its first parameter may vary over the road network: its values come per stretch of directed edge."""
    odd: bool = False  # The two directions of a road have opposite values (slope) ...
    one_way: bool = False  # ... or each its own, else they share one
    vector: bool = False  # The parameters are components of one quantity and are found together
    depends_on: tuple[str, ...] = ()  # The state variables that a mismatch follows where this term is missing
    sentence: str = ""
    """The finding in one sentence: a format string over the parameters by name (each with ``value``, ``low``,
    ``high`` and ``nominal``) and ``where``.  Empty: made from ``statement``."""
    extreme: str = ""  # Name of the largest value of a field in a report; empty: its first parameter's
    fault: Literal["", "clock", "mean", "scale"] = ""
    """Of a sensor term, how the fault is measured:
    by the clock of power, as a mean over time, by the scale of speed."""
    told: bool = True  # Whether it can be a finding; else it is only a tolerance of the truck file
    in_vocabulary: bool = True  # Else ``diagnosis.json`` says `unknown` and the numbers
    needs: str = ""  # What recording shows this effect apart from others; an imperative clause
    advice: str = ""  # What to do about it in the plant; imperative, without a full stop

    @property
    def waits(self) -> bool:
        """Whether it is time that vehicles stand still; what is told of it may well lie beside a junction."""
        return self.acts == "wait"

    @cached_property
    def by_name(self) -> dict[str, Parameter]:
        """Parameters by name."""
        return {p.name: p for p in self.parameters}


def total_mass(motion: Motion, truck: Truck) -> Floats:
    """Return truck and load, (N,) [kg]."""
    return truck.chassis.mass + motion.payload
