"""What each trip, or each day, has of its own where a mismatch differs from one to the next."""

from __future__ import annotations

import datetime as dt

import numpy as np

from fleetlog.discovery import generic
from fleetlog.discovery.estimate import sandwich
from fleetlog.discovery.linear import fit
from fleetlog.discovery.residual import Recording
from fleetlog.discovery.select import Choice
from fleetlog.discovery.task import State, Task, posed, selection

OWN = {"trip_id": "trips", "day": "days"}
"""Variables with a value of their own in every class, and what ``when`` calls the classes."""
TRIP = 1_000_000
"""Trip codes count on from this much of each vehicle."""


def own_values(task: Task, state: State, choice: Choice) -> dict[str, dict[str, list[float]]] | None:
    """``{"trips": {"7": [value, low, high]}}``: a share of the weight for a force, watts for a power; None for other variables.

    From all windows that can be used; the prior draws trips of which little is known towards what is usual.
    """
    depends, bench = choice.candidate.depends_on, task.recording
    if len(depends) != 1 or depends[0] not in OWN or not isinstance(bench, Recording):
        return None
    _, p = posed(task, state, bench.whole)
    s = selection(state, p)
    f = fit(p, s)
    part = f.part(s, choice.candidate.name)
    beta, covariance = f.beta[part], sandwich(p, f)[part, part]
    unit = generic.FORCE if choice.candidate.name.startswith("force") else generic.POWER
    names = _names(bench, depends[0])
    shared = len(beta) - len(names)
    # A class has its own part and what all have in common.
    add = np.concatenate([np.ones((len(names), shared)), np.eye(len(names))], axis=1)
    error = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", add, covariance, add), 0.0))
    seen = p.gram[p.at[choice.candidate.name], p.at[choice.candidate.name]][shared:] > 0.0
    rows = zip(names, add @ beta * unit, 1.96 * error * unit, seen, strict=True)
    return {OWN[depends[0]]: {n: [float(v), float(v - e), float(v + e)] for n, v, e, known in rows if known}}


def _names(bench: Recording, variable: str) -> list[str]:
    if variable == "trip_id":
        several = bench.ranges.vehicles > 1
        return [
            f"{code // TRIP}:{code % TRIP}" if several else str(code % TRIP) for code in bench.ranges.trips
        ]
    return [(dt.date(1970, 1, 1) + dt.timedelta(days=day)).isoformat() for day in bench.ranges.days]
