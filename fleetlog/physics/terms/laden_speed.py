"""Driving more slowly with a load."""

import numpy as np

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values

LADEN = 25.0  # Less than this on the forks is no load [kg]


def speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """Where there is a load, ``factor`` times the speed that the road allows (``motion.speed``), but no more
    than the share ``top`` of the truck's top speed and ``turns`` of its speed in turns; else inf [m/s]."""
    cap = np.minimum(values.get("factor", 1.0) * motion.speed, values.get("top", 1.0) * truck.drive.max_speed)
    if "turns" in values:
        bend = np.maximum(np.abs(motion.curvature), 1e-9)
        cap = np.minimum(cap, values["turns"] * np.sqrt(truck.drive.max_lateral_acceleration / bend))
    return np.where(motion.payload > LADEN, cap, np.inf)


TERM = Term(
    "laden_speed", "speed", "trucks drive more slowly with a load",
    (
        Parameter("factor", "1", 0.1, 2.0, neutral=1.0, tolerance=0.03, inverse=True, ceiling=True),
        Parameter(
            "turns", "1", 0.1, 1.05, neutral=1.0, inverse=True, reach=0.3,
            sentence="With a load, trucks take turns at {turns.value:.0%} ({turns.low:.0%} to "
            "{turns.high:.0%}) of their unladen speed",
        ),
        Parameter(
            "top", "1", 0.1, 1.05, neutral=1.0, inverse=True, reach=0.4,
            sentence="With a load, trucks drive at no more than {top.value:.0%} ({top.low:.0%} to "
            "{top.high:.0%}) of their top speed",
        ),
    ),
    speed, depends_on=("payload",),
    sentence="With a load, trucks drive at {factor.value:.0%} ({factor.low:.0%} to {factor.high:.0%}) of "
    "their unladen speed",
    needs="drive the same roads with and without a load",
    advice="Compare the laden speed limit of the drive controller with the truck file",
)  # fmt: skip
