"""Two clocks that disagree."""

from fleetlog.physics.term import Parameter, Term

# The log shows the power of ``offset`` seconds before; > 0: the channel runs behind the positions.
TERM = Term(
    "clock_offset", "sensor", "the power or load channel is shifted in time against the positions",
    (Parameter("offset", "s", -60.0, 60.0, tolerance=0.3),), fault="clock", depends_on=("time",),
    sentence="The power channel runs {offset.value:+.2f} s ({offset.low:+.2f} to {offset.high:+.2f}) behind "
    "the positions",
    needs="record starts and stops with both loggers",
    advice="Synchronise the clocks of the loggers; import earlier logs with this offset taken off",
)  # fmt: skip
