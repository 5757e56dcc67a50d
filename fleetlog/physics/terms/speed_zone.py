"""A road on which trucks drive more slowly than the limit."""

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def speed(motion: Motion, truck: Truck, values: Values) -> Floats:
    """v = factor times the speed that the road allows (``motion.speed``) [m/s]."""
    return values.get("factor", 1.0) * motion.speed


TERM = Term(
    "speed_zone", "speed", "trucks drive more slowly than the limit on some roads",
    (Parameter("factor", "1", 0.05, 1.05, neutral=1.0, inverse=True),), speed, field=True,
    depends_on=("x", "y"),
    sentence="Trucks drive at {factor.value:.0%} ({factor.low:.0%} to {factor.high:.0%}) of the permitted "
    "speed {where}",
    needs="record these roads without other traffic",
    advice="Find out what slows trucks there: people, the floor, a blind corner, or a limit that the map "
    "lacks",
)  # fmt: skip
