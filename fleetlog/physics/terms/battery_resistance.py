"""The loss inside the battery."""

from fleetlog.physics.term import Parameter, Term

# P = R (power / U)^2 [W], paid by the state of charge and not seen at the terminals: first order of the exact
# current at constant voltage U (see fleetlog.physics.battery).  About 12 mOhm for 48 V 625 Ah lead-acid,
# 4 mOhm for 48 V 405 Ah LFP (estimates).
TERM = Term(
    "battery_resistance", "loss", "the battery loses power inside, with the square of the current",
    (Parameter("resistance", "ohm", 0.0, 2.0, truck_key="battery.internal_resistance", tolerance=0.1),),
    depends_on=("battery_power",),
    sentence="The battery loses energy inside as a resistance of {resistance.value:.4f} ohm would "
    "({resistance.low:.4f} to {resistance.high:.4f}); the truck file has {resistance.nominal:.4f} ohm",
    needs="record both heavy and light work on one charge",
    advice="Have the battery's cells and connectors checked",
)  # fmt: skip
