"""A logger that reports means."""

from fleetlog.physics.term import Parameter, Term

# The log shows the mean of the power of the last ``interval`` seconds.
TERM = Term(
    "averaging", "sensor", "the logger reports the mean of its last interval, not the moment",
    (Parameter("interval", "s", 0.0, 120.0),), fault="mean", depends_on=("time",),
    sentence="The logger reports power as the mean of the last {interval.value:.1f} s, not the moment",
    needs="log at a higher rate", advice="Set the logger to write momentary values",
)  # fmt: skip
