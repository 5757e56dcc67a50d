"""Road slope."""

import numpy as np

from fleetlog.core.arrays import distinct
from fleetlog.physics.term import GRAVITY, Floats, Motion, Parameter, Term, Truck, Values, total_mass


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = m g sin(theta) [N], theta the map's slope along the motion plus what was found (``slope``: tan
    theta)."""
    mapped, found = distinct(motion.slope), values.get("slope", 0.0)
    sine = (np.sin(mapped) + found * np.cos(mapped)) / np.sqrt(1.0 + np.square(found))  # Of both angles
    return np.asarray(total_mass(motion, truck) * GRAVITY * sine)


TERM = Term(
    "grade", "force", "the road climbs or falls where the map is level",
    (Parameter("slope", "1", -0.3, 0.3, usual=0.03),), force, nominal=True, field=True, odd=True,
    depends_on=("x", "y", "heading"), extreme="max_grade",
    sentence="The road climbs or falls by up to {max_grade.value:.1%} ({max_grade.low:.1%} to "
    "{max_grade.high:.1%}) {where}; the map is level there",
    needs="drive these roads in both directions, or survey their elevation",
    advice="Enter the slope in the map; plan batteries and brakes with it until then",
)  # fmt: skip
