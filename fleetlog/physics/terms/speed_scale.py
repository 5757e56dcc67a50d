"""A speed sensor that reads in a wrong scale."""

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.term import Floats, Parameter, Term, Values


def recorded_speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """The speed that the log shows [m/s]: ``factor`` times the true one,
    as of worn tyres or a wrong wheel radius.
    """
    return np.asarray(values.get("factor", 1.0) * motion.speed)


TERM = Term(
    "speed_scale",
    "sensor",
    "the speed channel is scaled against the positions",
    (Parameter("factor", "1", 0.5, 2.0, neutral=1.0, tolerance=0.01),),
    recorded_speed,
    fault="scale",
    depends_on=("speed",),
    sentence="The speed channel reads {factor.value:.3f} times the true speed ({factor.low:.3f} to "
    "{factor.high:.3f}). "
    "Check the wheel diameter in the logger",
    needs="drive a measured distance",
    advice="Correct the wheel diameter in the logger",
)
