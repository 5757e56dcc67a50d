"""What power that is recorded at moments far apart lacks between them, told from the motion.

The state of charge knows all that a battery gave.  Rows three to seven seconds apart see so little of the
power that their sum misses it by a fifth, and whatever is proportional to that sum looks smaller than it is.
The error is taken out as errors in variables are (regression calibration, Carroll et al. 2006): what is
recorded is first told from what it follows, and the charge is judged against the best mean of both."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fleetlog.core.arrays import Floats, Mask
from fleetlog.discovery.channels.base import Channel, Unit
from fleetlog.discovery.hypotheses.sources import UNIT, FreeCurve, power_curves

DILUTED = 0.002
"""Power that is measured with errors of this share of its square makes whatever is proportional to it look
smaller by the same share (regression dilution); wider windows average the errors."""
FREE = 0.1  # Precision of the fleet's coefficients: three times their unit either way
SPREADS = tuple(2.0**k for k in range(-10, 3))  # Tried of all other coefficients, times their unit


@dataclass(frozen=True)
class Between:
    """How power is told from the motion: free curves with their coefficients ``beta`` beyond the model's.
    ``share`` of what that differs from recorded power by is to be believed."""

    curves: tuple[FreeCurve, ...]
    beta: Floats
    share: float

    def beyond(self, state: Mapping[str, Floats], drawn: Floats) -> Floats:
        """Return the power beyond the model's, (rows,) [W]; ``drawn`` (rows,) by the drive, in the model."""
        total, first = np.zeros(len(drawn)), 0
        for curve in self.curves:
            height = UNIT[curve.mode] * self.beta[first : first + curve.width]
            own = sum((share * height[column] for column, share in curve.hats(state)), np.zeros(len(drawn)))
            total += own * (drawn if curve.mode == "drive" else 1.0)
            first += curve.width
        return total


def learn(
    channel: Channel, motion: Channel, units: Iterable[tuple[Unit, Mask]], hidden: float, evidence: float
) -> Between:
    """Return what fits the units, each with the windows that may be used. ``motion`` is the same channel that
    looks at no recorded power; rows miss the energy by ``hidden`` of it."""
    units = list(units)
    curves = power_curves(channel.knots(u for u, _ in units), len(channel.fleet.vehicles))
    found = []
    for unit, use in units:
        told, columns = motion.columns(unit, channel.base, curves)
        rows = channel.predict(unit, channel.base)
        found.append(np.column_stack([unit.recorded, rows, told, columns])[use])
    paid, rows, told, columns = np.split(np.concatenate(found), [1, 2, 3], axis=1)
    beta = _likeliest(np.asarray(columns, np.float64), (rows - told).ravel(), evidence)
    expected = told + columns @ beta[:, None]
    own, other = np.linalg.lstsq(np.hstack([rows, expected]), paid, rcond=None)[0].ravel()
    # No more than what rows are known to miss may be told otherwise.
    most = hidden**2 * float((paid**2).sum()) / max(float(((rows - expected) ** 2).sum()), 1e-9)
    return Between(curves, beta, float(np.clip(other / (own + other), 0.0, min(most, 1.0))))


def _likeliest(columns: Floats, left: Floats, evidence: float) -> Floats:
    """(P,) coefficients; all but the fleet's two have a spread that the data choose (empirical Bayes). A
    greater spread must raise the logarithm of the marginal likelihood by ``evidence``."""
    gram, moment = columns.T @ columns, columns.T @ left
    square = float(left @ left - moment @ np.linalg.lstsq(gram, moment, rcond=None)[0]) / len(left)
    best, out = -np.inf, np.zeros(len(moment))
    for spread in SPREADS:
        prior = np.full(len(moment), 1.0 / spread**2)
        prior[:2] = FREE
        beta = np.linalg.solve(gram / square + np.diag(prior), moment / square)
        free = np.linalg.slogdet(gram / square / prior + np.eye(len(prior)))[1]
        likely = 0.5 * float(beta @ moment / square - free)
        if likely > best + evidence:
            best, out = likely, np.asarray(beta)
    return out
