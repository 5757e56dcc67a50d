"""Gathering speed."""

from fleetlog.physics.term import Parameter, Term

# dv/dt <= acceleration when setting off; no speed of its own, so only the truck's value changes.
TERM = Term(
    "acceleration_limit", "speed", "trucks gather speed more slowly than the truck file says",
    (Parameter("acceleration", "m/s2", 0.02, 5.0, truck_key="drive.max_acceleration", tolerance=0.1,
               inverse=True, ceiling=True),),
    depends_on=("acceleration",),
    sentence="Trucks accelerate at {acceleration.value:.2f} m/s2 ({acceleration.low:.2f} to "
    "{acceleration.high:.2f}); the truck file has {acceleration.nominal:.2f} m/s2",
    needs="record starts on open straights",
    advice="Compare the acceleration setting of the drive controller with the truck file",
)  # fmt: skip
