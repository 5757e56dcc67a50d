"""Standing still on the way: a door, a gate, a crossing."""

from fleetlog.physics.term import Parameter, Term

# A stretch of directed edge on which every passage stands for ``seconds``; the simulator stops there, power
# is unaffected.
TERM = Term(
    "waiting", "wait", "trucks stand still at places that the simulation drives through",
    (Parameter("seconds", "s", 0.0, 600.0),), field=True, one_way=True, depends_on=("x", "y", "heading"),
    sentence="Each passage waits {seconds.value:.0f} s on average ({seconds.low:.0f} to {seconds.high:.0f}) "
    "{where}, where the model drives through",
    needs="record what trucks wait for there",
    advice="Watch what trucks wait for there: a door, a scanner, a person",
)  # fmt: skip
