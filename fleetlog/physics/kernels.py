"""Compiled loops of battery and speed profile; imported only where they run."""

import numpy as np

from fleetlog.compiling import kernel, outer
from fleetlog.core.arrays import Floats, Mask
from fleetlog.physics.term import GRAVITY

AT_REST = 0.02  # A speed at a node under this means a stop [m/s]


@outer
def follow(
    power: Floats, dt: Floats, soc: float, knots: Floats, volts: Floats, resistance: float,
    capacity_ah: float, peukert: float, rated_current: float, out: Floats, marks: Mask,
) -> None:  # fmt: skip
    """Charge, voltage and current after each of (N,) samples into ``out`` (3, N), collapse and emptiness into
    ``marks`` (2, N); see :mod:`fleetlog.physics.battery`."""
    k = 0
    for i in range(len(power)):
        # Charge moves little from sample to sample: the knots are found by walking, not by searching.
        while k < len(knots) - 2 and soc > knots[k + 1]:
            k += 1
        while k > 0 and soc < knots[k]:
            k -= 1
        e = volts[k] + (soc - knots[k]) / (knots[k + 1] - knots[k]) * (volts[k + 1] - volts[k])
        radicand = e * e - 4.0 * resistance * power[i]
        if radicand < 0.0:
            marks[0, i] = True
            amps = e / (2.0 * resistance)
        else:
            amps = 2.0 * power[i] / (e + np.sqrt(radicand))
        drawn = amps
        if amps > 0.0 and peukert != 1.0:
            drawn = amps * (amps / rated_current) ** (peukert - 1.0)
        soc -= drawn * dt[i] / (3600.0 * capacity_ah)
        if soc <= 0.0:
            marks[1, i] = drawn > 0.0
            soc = 0.0
        soc = min(soc, 1.0)
        out[0, i], out[1, i], out[2, i] = soc, e - resistance * amps, amps


@kernel()
def quickest(
    distance: Floats, cap: Floats, slope: Floats, mass: Floats, wait: Floats, up: float, down: float,
    power: float, rolling: float,
) -> Floats:  # fmt: skip
    """(2, N) speeds and arrival times [s].

    Speeds are never above ``cap``, gathered with ``up`` and the power at the wheel, shed with ``down``;
    between two nodes the acceleration is constant, so the square of the speed is linear in distance.
    ``wait`` is spent at a node before going on.  A stretch with a stop at either end, or a hair from one, is
    driven up and down again within it."""
    n, square = len(distance), cap * cap
    out = np.zeros((2, n))
    for i in range(n - 1):
        ds = distance[i + 1] - distance[i]
        v, a = np.sqrt(square[i]), up
        level = slope[i] == 0.0
        resist = GRAVITY * (rolling if level else rolling * np.cos(slope[i]) + np.sin(slope[i]))
        if (up + resist) * mass[i] * v > power:
            a = power / (v * mass[i]) - resist
        square[i + 1] = min(square[i + 1], max(square[i] + 2.0 * a * ds, 0.0))
    for i in range(n - 1, 0, -1):
        ds = distance[i] - distance[i - 1]
        square[i - 1] = min(square[i - 1], square[i] + 2.0 * down * ds)
    out[0], shape = np.sqrt(square), 1.0 / up + 1.0 / down
    for i in range(n - 1):
        ds, v, w = max(distance[i + 1] - distance[i], 0.0), out[0, i], out[0, i + 1]
        stops = max(v, w) <= AT_REST
        took = np.sqrt(2.0 * ds * shape) if stops else 2.0 * ds / max(v + w, AT_REST)
        out[1, i + 1] = out[1, i] + wait[i] + took
    return out
