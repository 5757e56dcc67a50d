"""Acceleration of the mass."""

from fleetlog.physics.term import Floats, Motion, Term, Truck, Values, total_mass


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = m a [N]; Newton's second law, for a mass without rotating parts (see rotational_inertia)."""
    return total_mass(motion, truck) * motion.acceleration


TERM = Term("inertia", "force", "acceleration of truck and load", function=force, nominal=True)
