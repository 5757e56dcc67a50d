"""Driving more slowly with a load."""

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.term import Floats, Parameter, Term, Values

LADEN = 25.0
"""Less than this on the forks is no load [kg]."""


def speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """v = factor times the speed that the road allows (``motion.speed``) where there is a load,
    inf elsewhere [m/s].
    """
    return np.where(motion.payload > LADEN, values.get("factor", 1.0) * motion.speed, np.inf)


TERM = Term(
    "laden_speed",
    "speed",
    "trucks drive more slowly with a load",
    (Parameter("factor", "1", 0.1, 2.0, neutral=1.0, tolerance=0.03, inverse=True, ceiling=True),),
    speed,
    depends_on=("payload",),
    sentence="With a load, trucks drive at {factor.value:.0%} ({factor.low:.0%} to {factor.high:.0%}) of "
    "their unladen speed",
    needs="drive the same roads with and without a load",
)
