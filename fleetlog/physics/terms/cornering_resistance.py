"""Tyre scrub in turns."""

import numpy as np

from fleetlog.physics.term import GRAVITY, Floats, Motion, Parameter, Term, Truck, Values, total_mass


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = m g k |curvature| while rolling, 0 at rest [N]; ``k`` in metres.

    The part of scrub that remains at walking speed: twin and pivoting wheels are turned on the spot while
    they roll, so work grows with the angle turned, not with speed.  200 to 1000 N in a turn of 2 m radius is
    k of some 0.01 to 0.04 m for a truck of 5 t (our estimate)."""
    scrub = total_mass(motion, truck) * GRAVITY * values.get("k", 0.0) * np.abs(motion.curvature)
    return np.where(motion.speed > 0.0, scrub, 0.0)


TERM = Term(
    "cornering_resistance", "force", "turning costs extra force, as tyres scrub",
    (Parameter("k", "m", 0.0, 2.0),), force, depends_on=("curvature",),
    sentence="Turning costs extra force, as tyre scrub does: k = {k.value:.3f} m ({k.low:.3f} to "
    "{k.high:.3f})",
    needs="drive circles of two radii at one speed",
    advice="Check the tyres and the steering geometry",
)  # fmt: skip
