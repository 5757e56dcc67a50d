"""Rolling resistance that a stretch of floor adds."""

import numpy as np

from fleetlog.core.arrays import distinct
from fleetlog.physics.term import GRAVITY, Floats, Motion, Parameter, Term, Truck, Values, total_mass


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = (factor - 1) f m g cos(theta) while rolling, 0 at rest [N]; what the floor adds to the truck's own
    rolling.

    ``factor`` is the rolling coefficient here over that of the truck file: about 1.3 on worn asphalt, 2 on
    gravel, 4 on loose ground (worn and loose against new asphalt-concrete: Carvill, Mechanical Engineer's
    Data Handbook)."""
    pressed = total_mass(motion, truck) * GRAVITY * np.cos(distinct(motion.slope))
    extra = (np.asarray(values.get("factor", 1.0)) - 1.0) * truck.resistance.rolling
    return np.where(motion.speed > 0.0, extra * pressed, 0.0)


TERM = Term(
    "surface_resistance", "force", "the floor rolls harder on some roads, the same in both directions",
    (Parameter("factor", "1", 0.2, 10.0, neutral=1.0),), force, field=True, depends_on=("x", "y"),
    sentence="Rolling resistance {where} is {factor.value:.2f} times the value in the truck file "
    "({factor.low:.2f} to {factor.high:.2f}), in both directions",
    needs="drive these roads in both directions",
    advice="Walk these roads: look for a worn or soft floor, an open joint, dirt. Repair it, or lead traffic "
    "around it",
)  # fmt: skip
