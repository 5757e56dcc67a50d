"""Whatever is on while the key is on."""

import numpy as np

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = constant [W]; 150 to 500 W for controller, lights and display."""
    return np.full(len(motion), truck.auxiliary.power)


TERM = Term(
    "auxiliary_load", "power", "something draws constant power, driving or standing",
    (Parameter("power", "W", 0.0, 6000.0, truck_key="auxiliary.power", tolerance=0.1, added=True),), power,
    nominal=True,
    sentence="Auxiliary consumers draw {power.value:.0f} W ({power.low:.0f} to {power.high:.0f}) at all "
    "times; the truck file has {power.nominal:.0f} W",
    needs="record the truck standing with the key on",
    advice="Switch off heater, lights, fan and terminal one by one with the key on, and watch the current",
)  # fmt: skip
