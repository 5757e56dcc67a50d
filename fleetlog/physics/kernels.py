"""Compiled loops; imported only where they run."""

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import kernel

Floats = NDArray[np.float64]


@kernel()
def follow(
    power: Floats, dt: Floats, soc: float, knots: Floats, volts: Floats, resistance: float,
    capacity_ah: float, peukert: float, rated_current: float,
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]:  # fmt: skip
    """Charge, voltage, current, collapse and emptiness after each of (N,) samples;
    see :mod:`fleetlog.physics.battery`."""
    n = len(power)
    charge, voltage, current = np.empty(n), np.empty(n), np.empty(n)
    collapsed, empty = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    k = 0
    for i in range(n):
        # Charge moves little from sample to sample: the knots are found by walking, not by searching.
        while k < len(knots) - 2 and soc > knots[k + 1]:
            k += 1
        while k > 0 and soc < knots[k]:
            k -= 1
        e = volts[k] + (soc - knots[k]) / (knots[k + 1] - knots[k]) * (volts[k + 1] - volts[k])
        radicand = e * e - 4.0 * resistance * power[i]
        if radicand < 0.0:
            collapsed[i] = True
            amps = e / (2.0 * resistance)
        else:
            amps = 2.0 * power[i] / (e + np.sqrt(radicand))
        drawn = amps
        if amps > 0.0 and peukert != 1.0:
            drawn = amps * (amps / rated_current) ** (peukert - 1.0)
        soc -= drawn * dt[i] / (3600.0 * capacity_ah)
        if soc <= 0.0:
            empty[i] = drawn > 0.0
            soc = 0.0
        soc = min(soc, 1.0)
        charge[i], current[i], voltage[i] = soc, amps, e - resistance * amps
    return charge, voltage, current, collapsed, empty
