"""A logger that reports means."""

import numpy as np

from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.physics.term import Floats, Parameter, Term, Values


def recorded_power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """The power that the log shows [W]: the mean of ``motion.power`` over the last ``interval`` seconds."""
    interval = float(np.asarray(values.get("interval", 0.0)))
    if interval <= 0.0:
        return motion.power
    out = np.empty(len(motion))
    for vehicle in np.unique(motion.vehicle):
        rows = motion.vehicle == vehicle
        time, energy = motion.time[rows], np.cumsum(motion.power[rows] * motion.dt[rows])
        out[rows] = (energy - np.interp(time - interval, time, energy, left=0.0)) / interval
    return out


TERM = Term(
    "averaging",
    "sensor",
    "the logger reports the mean of its last interval, not the moment",
    (Parameter("interval", "s", 0.0, 120.0),),
    recorded_power,
    fault="mean",
    depends_on=("time",),
    sentence="The logger reports power as the mean of the last {interval.value:.1f} s, not the moment",
    needs="log at a higher rate",
    advice="Set the logger to write momentary values",
)
