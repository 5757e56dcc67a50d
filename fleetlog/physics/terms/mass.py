"""The weight of the truck itself."""

from fleetlog.physics.term import Parameter, Term

# m = chassis.mass + payload: attachments and batteries of another size are 3 to 15 % of a counterbalance
# truck (estimate).
TERM = Term(
    "mass", "truck", "the truck itself is heavier or lighter than the truck file says",
    (Parameter("mass", "kg", 20.0, 100000.0, truck_key="chassis.mass", tolerance=0.05),),
    depends_on=("acceleration", "speed"),
    sentence="The truck weighs {mass.value:.0f} kg ({mass.low:.0f} to {mass.high:.0f}) without load; the "
    "truck file has {mass.nominal:.0f} kg",
    needs="weigh the truck",
    advice="Weigh the truck, and enter its weight in the truck file",
)  # fmt: skip
