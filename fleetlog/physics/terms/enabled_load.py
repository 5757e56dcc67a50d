"""Electric load while the drive is enabled."""

import numpy as np

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = ``power`` while the truck moves and for ``hold`` seconds after, 0 else [W]. Inverters, brakes held
    open and fans; two real AGVs draw 172 and 72 W so."""
    row, moving = np.arange(len(motion)), motion.speed > 0.0
    last = np.maximum.accumulate(np.where(moving, row, -1))
    first = np.maximum.accumulate(np.where(np.diff(motion.vehicle, prepend=-1) != 0, row, 0))
    on = (last >= first) & (motion.time - motion.time[last] <= values.get("hold", 5.0))
    return np.asarray(values.get("power", 0.0) * on)


TERM = Term(
    "enabled_load", "power", "the enabled drive draws power while the truck moves and for some seconds after",
    (Parameter("power", "W", 0.0, 6000.0), Parameter("hold", "s", 0.0, 60.0, neutral=5.0, shape=True)), power,
    depends_on=("standing",),
    sentence="The enabled drive draws {power.value:.0f} W ({power.low:.0f} to {power.high:.0f}) while the "
    "truck moves and for {hold.value:.0f} s after",
    needs="record stops of different length with the key on",
    advice="Shorten the time after which the drive switches itself off",
)  # fmt: skip
