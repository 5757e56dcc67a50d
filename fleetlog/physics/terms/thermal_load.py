"""Heating and cooling that follow the temperature outside."""

import numpy as np

from fleetlog.physics.term import Floats, Motion, Parameter, Term, Truck, Values


def power(motion: Motion, truck: Truck, values: Values) -> Floats:
    """P = heating max(threshold - T, 0) + cooling max(T - threshold, 0) [W]; 0 where the temperature is
    unknown. Newton's law of cooling in the steady state. ``heating`` and ``cooling`` in W/K, ``threshold`` in
    degC. A cabin heater of 1 to 2 kW at 20 K below the threshold is 50 to 100 W/K (our estimate)."""
    above = np.nan_to_num(motion.ambient_temperature - values.get("threshold", 15.0), nan=0.0)
    heating, cooling = values.get("heating", 0.0), values.get("cooling", 0.0)
    return heating * np.maximum(-above, 0.0) + cooling * np.maximum(above, 0.0)


TERM = Term(
    "thermal_load", "power", "heating or cooling follows the outside temperature",
    (
        Parameter("heating", "W/K", 0.0, 1000.0), Parameter("cooling", "W/K", 0.0, 1000.0),
        Parameter("threshold", "degC", -20.0, 40.0, neutral=15.0, shape=True, bounds="ambient_temperature"),
    ),
    power, depends_on=("ambient_temperature",),
    sentence="Heating draws {heating.value:.0f} W and cooling {cooling.value:.0f} W more for every kelvin "
    "below or above {threshold.value:.0f} degC outside",
    needs="record days of different outside temperature",
    advice="Check the settings of heating and cooling",
)  # fmt: skip
