"""Standard error of an energy from the truck's numbers: first-order propagation of their priors.

Every sensitivity is a sum that the books hold already.  At the switch from traction to braking the drive
power is zero, so its move adds nothing to first order, and with E the energy of a group

    dE/d ln(efficiency) = -E_traction    dE/d ln(regeneration) = E_braking    dE/d ln(rolling) = E_rolling ...
"""

from collections.abc import Callable

import numpy as np
import pandas as pd

from fleetlog.calibrate.parameters import UNKNOWNS
from fleetlog.core.truck import Truck
from fleetlog.physics.power import Physics, all_terms

CARRIAGE = "lift.carriage_mass"


def relative_spreads(truck: Truck, physics: Physics) -> dict[str, float]:
    """Relative standard deviation of each number: from the physics' own interval, else from the prior."""
    spreads = {u.key: u.deviation(truck) / truck.value(u.key) for u in UNKNOWNS if truck.value(u.key) > 0.0}
    terms = all_terms()
    for name, parameters in physics.intervals.items():
        for parameter, (low, high) in parameters.items():
            key = terms[name].by_name[parameter].truck_key
            if key is not None and truck.value(key) > 0.0:
                spreads[key] = (high - low) / (2.0 * 1.96) / truck.value(key)
    return spreads


def parameter_variance(physics: Physics) -> Callable[[pd.DataFrame], pd.Series]:
    """A function of a table of sums [J]: the variance [J2] of each row's energy by the truck's numbers."""
    truck = physics.actual_truck()
    spread = relative_spreads(truck, physics)

    def variance(total: pd.DataFrame) -> pd.Series:
        def term(name: str) -> pd.Series:
            return total.get(f"J_{name}", pd.Series(0.0, index=total.index))

        raising = total["raising"]
        slopes = {
            "drive.efficiency": -total["traction"], "drive.regeneration": total["braking"],
            "resistance.rolling": term("rolling_resistance"),
            "resistance.drag_area": term("aerodynamic_drag"), "lift.efficiency": -raising,
            "lift.recuperation": term("lift_efficiency") - raising,
            "auxiliary.power": term("auxiliary_load"),
            CARRIAGE: raising * _carriage_share(truck, total),
        }  # fmt: skip
        parts = [np.square(slope * spread.get(key, 0.0)) for key, slope in slopes.items()]
        return pd.Series(np.sum(parts, axis=0), index=total.index)

    return variance


def _carriage_share(truck: Truck, total: pd.DataFrame) -> pd.Series:
    """Share of the lifted mass that is carriage, for the mean load of each row."""
    load = total["kilogram_metres"] / total["metres"].where(total["metres"] > 0.0)
    return truck.lift.carriage_mass / (truck.lift.carriage_mass + load.fillna(0.0) + 1e-9)
