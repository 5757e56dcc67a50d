"""Steady wind on the known drag area."""

import numpy as np

from fleetlog.physics.term import AIR_DENSITY, Floats, Motion, Parameter, Term, Truck, Values


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = 1/2 rho c_d A (u |u| - v^2) [N], u = v - w.h the air that meets the truck head on; 0 in still air.

    w = (``wind_east``, ``wind_north``) is where the air goes [m/s], h the unit vector of the motion.  Cross
    wind is left out: it pushes sideways.  Added to the drag in still air this is the drag in wind."""
    along = values.get("wind_east", 0.0) * np.cos(motion.heading)
    along = along + values.get("wind_north", 0.0) * np.sin(motion.heading)
    u = motion.speed - along
    return 0.5 * AIR_DENSITY * truck.resistance.drag_area * (u * np.abs(u) - motion.speed**2)


TERM = Term(
    "wind", "force", "a steady wind blows over the site",
    (Parameter("wind_east", "m/s", -25.0, 25.0), Parameter("wind_north", "m/s", -25.0, 25.0)), force,
    vector=True, depends_on=("heading", "speed"),
    sentence="A steady wind blows {wind_east.value:+.1f} m/s to the east ({wind_east.low:+.1f} to "
    "{wind_east.high:+.1f}) and {wind_north.value:+.1f} m/s to the north ({wind_north.low:+.1f} to "
    "{wind_north.high:+.1f})",
    needs="record the same roads on another, calm day",
    advice="Compare with a calm day; nothing is wrong with the trucks",
)  # fmt: skip
