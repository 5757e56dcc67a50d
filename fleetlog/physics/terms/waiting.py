"""Standing still on the way: a door, a gate, a crossing."""

from fleetlog.physics.term import Parameter, Term

# A stretch of directed edge on which every passage stands for ``seconds``; the simulator stops there, power is unaffected.
TERM = Term(
    "waiting",
    "speed",
    "trucks stand still at places that the simulation drives through",
    (Parameter("seconds", "s", 0.0, 600.0),),
    field=True,
    depends_on=("x", "y", "heading"),
)
