"""The load that is really on the forks."""

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def load(motion: Motion, truck: Truck, values: Values) -> Floats:
    """The payload that acts [kg]: ``factor`` times the recorded one; everything with mass in it follows."""
    return values.get("factor", 1.0) * motion.payload


TERM = Term(
    "payload", "load", "the true load differs from the recorded one",
    (Parameter("factor", "1", 0.1, 5.0, neutral=1.0, tolerance=0.05),), load, depends_on=("payload",),
    sentence="The true load is {factor.value:.2f} times the recorded one ({factor.low:.2f} to "
    "{factor.high:.2f})",
    needs="weigh a few loads",
    advice="Check the load cell with a known weight",
)  # fmt: skip
