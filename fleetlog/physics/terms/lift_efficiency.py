"""Raising and lowering the load."""

import numpy as np

from fleetlog.physics.term import GRAVITY, Floats, Motion, Parameter, Term, Truck, Values


def power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = (payload + carriage) g h' / efficiency raising, times recuperation lowering [W];
    h' = d fork_height / dt."""
    work = (motion.payload + truck.lift.carriage_mass) * GRAVITY * motion.lift_speed
    return np.where(motion.lift_speed > 0.0, work / truck.lift.efficiency, work * truck.lift.recuperation)


TERM = Term(
    "lift_efficiency", "power", "the hydraulic lift is less efficient than the truck file says",
    (Parameter("efficiency", "1", 0.1, 1.0, truck_key="lift.efficiency", tolerance=0.1, inverse=True),),
    power, cause="lifting", nominal=True, depends_on=("lift_speed", "payload"),
    sentence="The hydraulic lift has an efficiency of {efficiency.value:.1%} ({efficiency.low:.1%} to "
    "{efficiency.high:.1%}); the truck file has {efficiency.nominal:.1%}",
    needs="record lifts with and without a load",
    advice="Check the oil, filter and pump of the hydraulics",
)  # fmt: skip
