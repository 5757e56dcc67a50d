"""A force that grows in proportion to speed."""

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def force(motion: Motion, truck: Truck, values: Values) -> Floats:
    """F = c v [N], ``coefficient`` c in N s/m: churning oil in gears and hubs, eddy currents; not by load."""
    return values.get("coefficient", 0.0) * motion.speed


TERM = Term(
    "viscous_drag", "force", "a drag that grows in proportion to speed, as of oil in gears",
    (Parameter("coefficient", "N s/m", 0.0, 1000.0),), force, depends_on=("speed",),
    sentence="A drag of {coefficient.value:.0f} N for every m/s of speed is missing ({coefficient.low:.0f} "
    "to {coefficient.high:.0f}), as oil in gears causes",
    needs="drive the same road at three speeds, the highest included",
    advice="Check the gearbox oil: grade, level and temperature",
)  # fmt: skip
