"""From wheel to battery."""

from fleetlog.physics.term import Parameter, Term

# P = F v regeneration where F v < 0; 0 for trucks that brake by friction, up to some 0.7 (estimate).
TERM = Term(
    "regeneration", "truck", "braking returns more or less energy than the truck file says",
    (Parameter("regeneration", "1", 0.0, 1.0, truck_key="drive.regeneration", tolerance=0.15),),
    depends_on=("acceleration",),
    sentence="Braking returns {regeneration.value:.0%} of the braking work to the battery "
    "({regeneration.low:.0%} to {regeneration.high:.0%}); the truck file has {regeneration.nominal:.0%}",
    needs="record hard and gentle braking from one speed",
    advice="Compare the braking settings of the drive controller with those of the other trucks",
)  # fmt: skip
