"""Loss in motor windings and cables."""

import numpy as np

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = k F^2 [W], F the sum of all forces at the wheel; ``k`` in W/N2.

    Joule heat of a motor current that is proportional to the torque.  A 10 kW drive that loses 4 % at 3 kN
    has k = 4.4e-5 W/N2 (our estimate)."""
    return np.asarray(values.get("k", 0.0) * np.where(motion.speed > 0.0, values["force"], 0.0) ** 2)


TERM = Term(
    "copper_loss", "drive", "drive and cables lose power with the square of the wheel's force",
    (Parameter("k", "W/N2", 0.0, 0.01),), power, depends_on=("acceleration", "payload"),
    sentence="Drive and cables lose {k.value:.2e} W for every N2 of wheel force ({k.low:.2e} to "
    "{k.high:.2e})",
    needs="record strong and gentle starts at one load",
    advice="Check the power cables and connectors for heat",
)  # fmt: skip
