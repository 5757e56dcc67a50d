"""The traction battery: open-circuit voltage over charge, resistance or Peukert, temperature; its limit.

    U = E(q) - R I,  P = U I   so   I = 2 P / (E + sqrt(E^2 - 4 R P))          exact; I > 0 discharging
    dq/dt = -I_eff / (3600 C(T)),  I_eff = I (I / I_n)^(k - 1) discharging, I charging

The power that a battery can give ends at E^2 / (4 R): beyond it the voltage collapses, which is reported
sample by sample, the current being that of greatest power.  Peukert's exponent k and the resistance R
describe the same loss; a model has one of them.  Where E is constant, I E = P + R (P / E)^2 + O(R^2): the
nominal formula of :func:`fleetlog.physics.power.cell_power`.

Sources: Peukert for changing current, normalised at the rated current I_n (Doerffel and Sharkh, J. Power
Sources 155, 2006, doi 10.1016/j.jpowsour.2005.04.030).  The curves E(q) and the temperature slopes below are
estimates of ours, typical of the chemistry and no maker's data."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.truck import Truck
from fleetlog.errors import TruckError, chosen

REFERENCE_TEMPERATURE = 20.0  # At which capacity and resistance are stated [degC]
CHARGING = -300.0  # A standing truck whose battery takes more is being charged [W]: no wheel gave it
COLDEST = 0.2  # Share of capacity that remains however cold it is: the linear law would go through zero


@dataclass(frozen=True)
class BatteryModel:
    """One battery."""

    capacity_ah: float  # Charge at the rated current and 20 degC [Ah]
    soc: tuple[float, ...]  # Knots of the open-circuit voltage: (K,) shares, growing from 0 to 1 ...
    voltage: tuple[float, ...]  # ... and (K,) volts
    resistance: float = 0.0  # At 20 degC [ohm]
    peukert: float = 1.0  # Exponent k, 1 where rate does not matter
    rated_hours: float = 5.0  # Discharge time that the capacity is rated at [h]
    capacity_per_kelvin: float = 0.0  # Share lost per kelvin below 20 degC
    resistance_per_kelvin: float = 0.0  # Share gained per kelvin below 20 degC

    def __post_init__(self) -> None:
        if self.resistance > 0.0 and self.peukert != 1.0:
            what = "the battery has a resistance and a Peukert exponent, which describe the same loss"
            raise TruckError(what, do="set one of them to 0 or 1")


# Volts per nominal volt over state of charge; estimates typical of the chemistry.
_KNOTS = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
_LFP = (0.90, 0.98, 1.00, 1.015, 1.025, 1.035, 1.04, 1.07)
_LEAD = (0.975, 0.985, 0.995, 1.015, 1.035, 1.05, 1.058, 1.065)
CHEMISTRIES: dict[str, BatteryModel] = {
    "constant": BatteryModel(1.0, (0.0, 1.0), (1.0, 1.0)),
    "lfp": BatteryModel(1.0, _KNOTS, _LFP, capacity_per_kelvin=0.004, resistance_per_kelvin=0.05),
    "lead": BatteryModel(1.0, _KNOTS, _LEAD, capacity_per_kelvin=0.01, resistance_per_kelvin=0.02),
}


def battery_of(truck: Truck, chemistry: str = "constant", peukert: float = 1.0) -> BatteryModel:
    """The battery of a truck file, with the shape of a chemistry (``constant``, ``lfp``, ``lead``). Its
    charge is capacity_wh / voltage; a ``peukert`` other than 1 stands in place of the resistance."""
    shape = chosen(CHEMISTRIES, chemistry, f"unknown chemistry {chemistry!r}", TruckError)
    nominal = truck.battery.voltage
    return replace(
        shape, capacity_ah=truck.battery.capacity_wh / nominal,
        voltage=tuple(v * nominal for v in shape.voltage),
        resistance=truck.battery.internal_resistance if peukert == 1.0 else 0.0, peukert=peukert,
    )  # fmt: skip


class Discharge(NamedTuple):
    """What a battery did, (N,) each."""

    soc: Floats  # State of charge after each sample
    voltage: Floats  # At the terminals [V]
    current: Floats  # [A]
    collapsed: Mask  # The power asked for is more than the battery can give
    empty: Mask  # Charge is at 0 and more is drawn


def discharge(
    power: Floats, dt: Floats, battery: BatteryModel, soc: float, temperature: float = float("nan")
) -> Discharge:
    """Follow a battery through (N,) terminal powers [W] of (N,) durations [s] from a state of charge, kept
    within 0 and 1; samples that would leave it empty are marked.  A NaN temperature counts as 20 degC."""
    from fleetlog.physics.kernels import follow

    below = 0.0 if np.isnan(temperature) else REFERENCE_TEMPERATURE - temperature
    values, marks = np.empty((3, len(power))), np.zeros((2, len(power)), np.bool_)
    follow(
        np.ascontiguousarray(power, dtype=np.float64), np.ascontiguousarray(dt, dtype=np.float64), float(soc),
        np.array(battery.soc), np.array(battery.voltage),
        battery.resistance * max(1.0 + battery.resistance_per_kelvin * below, 0.25),
        battery.capacity_ah * max(1.0 - battery.capacity_per_kelvin * below, COLDEST),
        battery.peukert, battery.capacity_ah / battery.rated_hours, values, marks,
    )  # fmt: skip
    return Discharge(*values, *marks)
