"""From battery to wheel."""

from fleetlog.physics.term import Parameter, Term

# P = F v / efficiency where F v >= 0: controller, motor and gear together, 0.65 to 0.85 for industrial trucks
# (estimate).
TERM = Term(
    "drivetrain_efficiency", "truck",
    "the drive loses more or less between battery and wheel than the truck file says",
    (Parameter("efficiency", "1", 0.3, 1.0, truck_key="drive.efficiency", tolerance=0.03, inverse=True),),
    depends_on=("speed", "acceleration"),
    sentence="The drive turns {efficiency.value:.1%} of the battery's energy into motion "
    "({efficiency.low:.1%} to {efficiency.high:.1%}); the truck file has {efficiency.nominal:.1%}",
    needs="let a truck coast to a stop, with and without a load",
    advice="Have motor, gearbox and inverter checked",
)  # fmt: skip
