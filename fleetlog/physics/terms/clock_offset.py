"""Two clocks that disagree."""

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.term import Floats, Parameter, Term, Values


def recorded_power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """The power that the log shows at each time [W]: that of ``offset`` seconds before,
    ``motion.power(t - offset)``.

    ``offset`` > 0: the channel runs behind the positions.  The vehicles of a motion are shifted one by one.
    """
    out = np.empty(len(motion))
    for vehicle in np.unique(motion.vehicle):
        rows = motion.vehicle == vehicle
        time = motion.time[rows]
        out[rows] = np.interp(time - values.get("offset", 0.0), time, motion.power[rows])
    return out


TERM = Term(
    "clock_offset",
    "sensor",
    "the power or load channel is shifted in time against the positions",
    (Parameter("offset", "s", -60.0, 60.0, tolerance=0.3),),
    recorded_power,
    fault="clock",
    depends_on=("time",),
    sentence="The power channel runs {offset.value:+.2f} s ({offset.low:+.2f} to {offset.high:+.2f}) behind "
    "the positions. "
    "Synchronise the clocks of the two loggers",
    needs="record starts and stops with both loggers",
    advice="Synchronise the clocks of the loggers; import earlier logs with this offset taken off",
)
