"""A road on which trucks drive more slowly than the limit."""

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.term import Floats, Parameter, Term, Values


def speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """v = factor times the speed that the road allows (``motion.speed``) [m/s]."""
    return np.asarray(values.get("factor", 1.0) * motion.speed)


TERM = Term(
    "speed_zone",
    "speed",
    "trucks drive more slowly than the limit on some roads",
    (Parameter("factor", "1", 0.05, 2.0, neutral=1.0),),
    speed,
    field=True,
    depends_on=("x", "y"),
)
