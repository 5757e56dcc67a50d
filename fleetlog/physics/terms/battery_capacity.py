"""How much energy the battery holds."""

from fleetlog.physics.term import Parameter, Term

# d soc/dt = - P / (3600 capacity_wh): the state of charge falls faster when cells have aged or were swapped
# for smaller ones.
TERM = Term(
    "battery_capacity", "loss", "the battery holds more or less energy than the truck file says",
    (Parameter("capacity_wh", "Wh", 10.0, 1e6, truck_key="battery.capacity_wh", tolerance=0.03,
               inverse=True),),
    depends_on=("battery_power", "soc"),
    sentence="The battery holds {capacity_wh.value:.0f} Wh ({capacity_wh.low:.0f} to "
    "{capacity_wh.high:.0f}); the truck file has {capacity_wh.nominal:.0f} Wh",
    needs="record one full discharge",
    advice="Have the battery's capacity tested; plan shorter runs until then",
)  # fmt: skip
