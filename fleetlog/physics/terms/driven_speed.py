"""What drivers use of the permitted speed."""

from fleetlog.physics.term import Parameter, Term

# v = share times the limit: a driver's habit, a little different in every recording.
TERM = Term(
    "driven_speed", "speed", "drivers use more or less of the permitted speed than the truck file says",
    (Parameter("share", "1", 0.3, 1.3, truck_key="drive.speed_factor", tolerance=0.05, inverse=True),),
    depends_on=("speed",), told=False,
)  # fmt: skip
