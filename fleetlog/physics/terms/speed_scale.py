"""A speed sensor that reads in a wrong scale."""

from fleetlog.physics.term import Parameter, Term

# The log shows ``factor`` times the true speed, as of worn tyres or a wrong wheel radius.
TERM = Term(
    "speed_scale", "sensor", "the speed channel is scaled against the positions",
    (Parameter("factor", "1", 0.5, 2.0, neutral=1.0, tolerance=0.01),), fault="scale", depends_on=("speed",),
    sentence="The speed channel reads {factor.value:.3f} times the true speed ({factor.low:.3f} to "
    "{factor.high:.3f})",
    needs="drive a measured distance",
    advice="Correct the wheel diameter in the logger",
)  # fmt: skip
