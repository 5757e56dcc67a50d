"""What the best model could know: the share of the error that each true term removes.

The oracle has the generator's own balance, the true motion but for what smoothing leaves of the noise of the
speed, the loads as weighed, the truck file, and one adjustment within its tolerance for each number of each
truck.  Its error with every true term is the noise floor; its error without a term tells what that term is
worth.  Travel times are those of a nominal driver beside drivers who differ and are held up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from effects import Effect
from observe import Seen
from scipy.optimize import lsq_linear
from shifts import Legs

SHOWS = {
    "battery_power": ("battery_power", "soc"),
    "soc": ("soc",),
    "speed": ("speed",),
    "distance": ("distance",),
}
"""Where an effect on a channel is seen; the first that the log has counts."""


def channels(seen: Sequence[Seen], legs: Sequence[Legs]) -> dict[str, dict[str, float]]:
    """Error of every channel by the effect left out of the model: ``""`` none, ``*`` all of them."""
    out = {}
    for name in ("battery_power", "soc", "distance"):
        have = [s for s in seen if name in s.logged]
        if have:
            out[name] = {which: _energy_error(have, name, which) for which in have[0].models[name]}
    out["speed"] = {which: _time_error(legs, which) for which in legs[0].nominal}
    return out


def share(effect: Effect, errors: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Channel on which an effect is judged, its error without and with the effect, and the share removed."""
    name = next((c for c in SHOWS[effect.channel] if c in errors), None)
    if name is None:
        return {"channel": None, "before": 0.0, "after": 0.0, "share": 0.0}
    before, after = errors[name].get(effect.term, errors[name][""]), errors[name][""]
    gain = max(1.0 - after / before, 0.0) if before > 0 else 0.0
    return {"channel": name, "before": before, "after": after, "share": gain}


def _energy_error(seen: Sequence[Seen], name: str, which: str) -> float:
    """Root mean square of what stays, over that of the energy, after the adjustments of every truck."""
    left, whole = 0.0, 0.0
    for vehicle in sorted({s.vehicle for s in seen}):
        days = [s for s in seen if s.vehicle == vehicle]
        logged = np.concatenate([s.logged[name] for s in days])
        rest = logged - np.concatenate([s.models[name][which] for s in days])
        columns = np.vstack([s.adjust[name] for s in days])
        if 0 < 3 * columns.shape[1] < len(rest):
            rest = rest - columns @ lsq_linear(columns, rest, (-1.0, 1.0)).x
        left, whole = left + float(rest @ rest), whole + float(logged @ logged)
    return float(np.sqrt(left / whole)) if whole else 0.0


def _time_error(legs: Sequence[Legs], which: str) -> float:
    """The same of travel times; a truck's pace may differ by three per cent."""
    left, whole = 0.0, 0.0
    for vehicle in sorted({one.vehicle for one in legs}):
        days = [one for one in legs if one.vehicle == vehicle]
        pairs = [p for d in days for p in zip(d.driven, d.nominal[which], strict=True)]
        sizes = [min(len(a), len(b)) for a, b in pairs]
        driven = np.concatenate([a[:n] for (a, _), n in zip(pairs, sizes, strict=True)])
        nominal = np.concatenate([b[:n] for (_, b), n in zip(pairs, sizes, strict=True)])
        pace = np.clip(driven @ nominal / (nominal @ nominal), 0.97, 1.03)
        rest = driven - pace * nominal
        left, whole = left + float(rest @ rest), whole + float(driven @ driven)
    return float(np.sqrt(left / whole)) if whole else 0.0
