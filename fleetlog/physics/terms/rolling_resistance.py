"""Rolling resistance."""

import numpy as np

from fleetlog.core.arrays import distinct
from fleetlog.physics.term import GRAVITY, Floats, Motion, Parameter, Term, Truck, Values, total_mass


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = f m g cos(theta) while rolling, 0 at rest [N]. f is about 0.006 to 0.02 for tyres on asphalt or
    concrete, 0.012 to 0.025 for superelastic tyres; independent of speed below some 10 m/s."""
    pressed = total_mass(motion, truck) * GRAVITY * np.cos(distinct(motion.slope))
    return np.where(motion.speed > 0.0, truck.resistance.rolling * pressed, 0.0)


TERM = Term(
    "rolling_resistance", "force", "tyres roll harder or easier than the truck file says, everywhere",
    (Parameter("coefficient", "1", 0.001, 0.15, truck_key="resistance.rolling", tolerance=0.1),), force,
    nominal=True, depends_on=("payload",),
    sentence="The rolling resistance coefficient is {coefficient.value:.4f} ({coefficient.low:.4f} to "
    "{coefficient.high:.4f}); the truck file has {coefficient.nominal:.4f}",
    needs="let a truck coast to a stop, with and without a load",
    advice="Lift the truck and turn every wheel by hand: a dragging brake or a worn bearing resists. Check "
    "the tyres",
)  # fmt: skip
