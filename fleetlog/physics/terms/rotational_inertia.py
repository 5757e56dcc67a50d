"""Wheels, gears and rotors that are spun up with the truck."""

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values, total_mass


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = (factor - 1) m a [N]; ``factor`` = 1 + sum(J i^2 / r^2) / m,
    about 1.05 to 1.15 for electric trucks (estimate)."""
    return (values.get("factor", 1.0) - 1.0) * total_mass(motion, truck) * motion.acceleration


TERM = Term(
    "rotational_inertia", "force", "more mass is accelerated than was weighed, as of rotating parts",
    (Parameter("factor", "1", 1.0, 2.0, neutral=1.0, tolerance=0.05),), force, depends_on=("acceleration",),
    sentence="Accelerating takes the force of {factor.value:.2f} times the weighed mass ({factor.low:.2f} to "
    "{factor.high:.2f}), as rotating parts cause",
    needs="record strong and gentle starts at one load",
    advice="Enter the factor in the model; nothing is wrong with the truck",
)  # fmt: skip
