"""Braking."""

from fleetlog.physics.term import Parameter, Term

# |dv/dt| <= deceleration when stopping: drivers differ, and a profile of constant deceleration is only
# roughly theirs.
TERM = Term(
    "braking", "speed", "trucks brake harder or more gently than the truck file says",
    (Parameter("deceleration", "m/s2", 0.05, 8.0, truck_key="drive.max_deceleration", tolerance=0.25,
               inverse=True),),
    depends_on=("acceleration",), told=False,
)  # fmt: skip
