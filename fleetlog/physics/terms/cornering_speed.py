"""Slowing down for turns."""

import numpy as np

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """v = sqrt(a_lat / |curvature|) [m/s], inf on straights;
    a_lat of 1 to 1.5 m/s2 is usual for laden trucks (estimate)."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.sqrt(truck.drive.max_lateral_acceleration / np.abs(motion.curvature))


TERM = Term(
    "cornering_speed", "speed", "trucks take turns more slowly than the truck file says",
    (Parameter("lateral_acceleration", "m/s2", 0.02, 8.0, truck_key="drive.max_lateral_acceleration",
               tolerance=0.15, inverse=True, ceiling=True),),
    speed, nominal=True, depends_on=("curvature",),
    sentence="Trucks take turns at a lateral acceleration of {lateral_acceleration.value:.2f} m/s2 "
    "({lateral_acceleration.low:.2f} to {lateral_acceleration.high:.2f}); the truck file has "
    "{lateral_acceleration.nominal:.2f} m/s2",
    needs="record turns on several roads",
    advice="Compare the cornering limit of the drive controller with the truck file",
)  # fmt: skip
