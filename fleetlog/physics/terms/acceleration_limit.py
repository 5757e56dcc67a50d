"""Gathering speed."""

from fleetlog.physics.term import Parameter, Term

# dv/dt <= acceleration when setting off; no speed of its own, so only the truck's value changes.
TERM = Term(
    "acceleration_limit",
    "speed",
    "trucks gather speed more slowly or faster than the truck file says",
    (Parameter("acceleration", "m/s2", 0.02, 5.0, truck_key="drive.max_acceleration"),),
    depends_on=("acceleration",),
)
