"""Choosing among explanations by how well they predict what was held out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.candidates import Candidate, Knob
from fleetlog.discovery.evidence import Evidence
from fleetlog.discovery.fields import usual
from fleetlog.discovery.linear import Fit, Hold, Problem, Selection, fit, loss, refit_tau

Floats = NDArray[np.float64]

ALPHA = 0.01
"""Family-wise p-value that an explanation must reach."""
LEAST_EVIDENCE = 4.0
LEAST_GAIN = 0.01
"""Share of the held-out error that an explanation must remove."""
KEPT = 0.4
"""Share of its gain that an explanation must keep on other kinds of split."""
NEAR = 0.85
"""Explanations with this share of the best gain are practically as good."""
SHAPE = 0.5
"""Share of a free curve's gain at which a term over the same variables is what the curve says."""
ALIKE = frozenset({
    frozenset({"rotational_inertia", "drivetrain_efficiency"}), frozenset({"rolling_resistance", "drivetrain_efficiency"}),
    frozenset({"rolling_resistance", "viscous_drag"}), frozenset({"aerodynamic_drag", "viscous_drag"}),
})  # fmt: skip
"""Pairs that a small error of the replay can exchange: significance alone must not decide between them."""
ONE_WAY = frozenset({"grade", "surface_resistance"})
"""The same on roads driven one way only, but for what a slope gives back downhill."""
CLOSE = 0.65
"""Share of the gain at which the other of such a pair stays possible."""
DOUBT = 2.5
"""Standard errors by which held-out trips must prefer one explanation to another."""
TOUCHED = 0.25
"""Windows with this share of what is usual where an effect is are touched by it."""
SHORT = 9
COST = {"scalar": 1.0, "field": 3.0, "generic": 4.0}


@dataclass(frozen=True)
class Gain:
    """What an explanation gains on every kind of split, as a share of the error without it; ``trips`` each held-out trip's part."""

    by_split: dict[str, float]
    standard_error: dict[str, float]
    trips: Floats
    share: float
    tau: float

    @property
    def trip(self) -> float:
        """On unseen trips."""
        return self.by_split["trip"]

    def worst(self, named: bool) -> float:
        """Smallest share of the gain that is kept on another split."""
        g = max(self.trip, 1e-9)
        kept = [v / g for k, v in self.by_split.items() if k in ("block", "place")]
        if "vehicle" in self.by_split:
            kept.append((1.0 if named else 0.0) + self.by_split["vehicle"] / g)
        return min(kept, default=1.0)


@dataclass(frozen=True)
class Choice:
    """The explanation chosen at a step, and what it was chosen over."""

    candidate: Candidate
    evidence: Evidence
    gain: Gain
    knobs: tuple[Knob, ...] = ()
    rivals: dict[str, Gain] = field(default_factory=dict)
    tied: tuple[str, ...] = ()


def cross_validate(p: Problem, s: Selection, kind: str, hold: Hold | None = None) -> Floats:
    """(folds,) held-out mean squared weighted residual."""
    return _losses(p, _fits(p, s, kind, hold), kind)


def _fits(p: Problem, s: Selection, kind: str, hold: Hold | None = None) -> list[Fit]:
    """One fit for each fold, made without it."""
    return [fit(p, s, fold, inverse=False, hold=hold) for fold in p.folds(kind)]


def _losses(p: Problem, fits: list[Fit], kind: str) -> Floats:
    return np.array([loss(f, fold) for f, fold in zip(fits, p.folds(kind), strict=True)])


def _by_trip(p: Problem, fits: list[Fit]) -> Floats:
    """(trips,) sum of squared weighted residuals of every trip when its fold was held out."""
    total = np.zeros(int(p.trip.max()) + 1)
    for k, f in enumerate(fits):
        rows = p.fold["trip"] == k
        residual = (p.y - p.predicted(f.columns, f.beta))[rows]
        total += np.bincount(p.trip[rows], residual**2, len(total))
    return total


def splits_for(p: Problem, c: Candidate) -> list[str]:
    """Kinds of split that may be asked of an explanation: a place field cannot predict unseen places."""
    out = [k for k in p.fold if not (k == "place" and c.place)]
    if "vehicle_id" in c.depends_on:
        out = [k for k in out if k != "vehicle"]
    if {"day", "time"} & set(c.depends_on):
        out = [k for k in out if k != "block"]
    if "trip_id" in c.depends_on:
        out = ["trip"]
    return out


def gain_of(
    p: Problem,
    s: Selection,
    without: Selection,
    c: Candidate,
    e: Evidence,
    base: dict[str, Floats],
    root: Floats,
    energy: Floats,
    hold: Hold | None = None,
) -> Gain:
    """Cross-validated gain of adding ``c``.

    ``without`` lacks the nuisances that ``c`` makes needless; ``base`` caches the losses of ``s``; ``root`` (W,) is
    that of the weights and ``energy`` (W,) what was recorded; ``hold`` the group to what is plausible.
    """
    with_it = without.add(c.name, e.columns, max(e.tau, 1e-12))
    if c.kind != "scalar":
        with_it = refit_tau(p, with_it, 3)
    by_split: dict[str, float] = {}
    error: dict[str, float] = {}
    on_trips = _fits(p, with_it, "trip", hold)
    for kind in splits_for(p, c):
        if kind not in base:
            base[kind] = cross_validate(p, s, kind)
        fits = on_trips if kind == "trip" else _fits(p, with_it, kind, hold)
        difference = base[kind] - _losses(p, fits, kind)
        scale = base["trip"].mean() if "trip" in base else base[kind].mean()
        by_split[kind] = float(difference.mean() / scale)
        error[kind] = float(difference.std(ddof=1) / np.sqrt(len(difference)) / scale)
    if "every trip" not in base:
        base["every trip"] = _by_trip(p, _fits(p, s, "trip"))
    trips = (base["every trip"] - _by_trip(p, on_trips)) / base["every trip"].sum()
    error["trip"] = float(trips.std(ddof=1) * np.sqrt(len(trips)))
    f = fit(p, with_it, inverse=False, hold=hold)
    if c.kind == "scalar":
        own = f.nuisances + sum(len(v) for v in s.columns.values())
        effect = p.predicted(f.columns[own:], f.beta[own:])
    else:
        # Of a free shape only what the honest errors could not say as well.
        g = fit(p, s, inverse=False)
        effect = p.predicted(f.columns, f.beta) - p.predicted(g.columns, g.beta)
    return Gain(by_split, error, trips, material_share(effect / root, energy, c.place), with_it.tau[c.name])


def material_share(effect: Floats, energy: Floats, place: bool) -> float:
    """Share of the energy that an effect makes up, where it is tied to places over those it touches."""
    size = np.abs(effect)
    touched = size > TOUCHED * usual(size) if place else np.ones(len(size), bool)
    return float(size[touched].sum() / max(np.abs(energy[touched]).sum(), 1e-12))


def choose(
    candidates: dict[str, Candidate],
    evidence: dict[str, Evidence],
    gains: dict[str, Gain],
    need: float,
    material: tuple[float, float],
) -> Choice | None:
    """The explanation to add: it must generalise, be material, and then the simpler and the named go first.

    ``material`` is the least share of everything, and of the places touched, that counts.
    """
    good = {
        k: g for k, g in gains.items()
        if g.trip >= need and g.trip > 2.0 * g.standard_error["trip"] and g.worst(candidates[k].named) > KEPT
        and g.share >= _least_share(candidates[k], material)
    }  # fmt: skip
    if not good:
        return None
    outside = [g.trip for k, g in good.items() if not candidates[k].internal]
    if outside:
        # A curve over the model's own state (speed, load) must beat the best other explanation by half.
        good = {k: g for k, g in good.items() if not candidates[k].internal or g.trip > 1.5 * max(outside)}
    best = max(g.trip for g in good.values())
    near = [k for k, g in good.items() if g.trip >= NEAR * best]
    near += [k for k in good if k not in near and _same_in_another_shape(candidates, good, near, k)]
    pool = [k for k in near if not candidates[k].place] or near
    pool = [k for k in pool if candidates[k].named] or pool
    chosen = max(pool, key=lambda k: good[k].trip - 0.05 * best * COST[candidates[k].kind])
    chosen = _free_map(candidates, good, chosen)
    tied = tuple(
        k
        for k in gains
        if k != chosen
        and candidates[k].named
        and _rivals(candidates[k], gains[k], candidates[chosen], gains[chosen])
    )
    rivals = {k: g for k, g in gains.items() if k != chosen}
    return Choice(candidates[chosen], evidence[chosen], good[chosen], (), rivals, tied)


def _free_map(candidates: dict[str, Candidate], good: dict[str, Gain], chosen: str) -> str:
    """The free map of places in place of a named one that is even in direction, where trips cannot tell the two apart."""
    term = candidates[chosen].term
    if term is None or not term.field or term.odd:
        return chosen
    free = [k for k, c in candidates.items() if k in good and c.place and not c.named]
    return next((k for k in free if _tied(good[k], good[chosen])), chosen)


def _same_in_another_shape(
    candidates: dict[str, Candidate], good: dict[str, Gain], near: list[str], name: str
) -> bool:
    """Whether a named term is what the best free curves say, over the same variables, in a shape not quite its own."""
    c = candidates[name]
    free = [k for k in near if not candidates[k].named]
    return (
        c.named
        and len(free) == len(near)
        and any(
            set(candidates[k].depends_on) <= set(c.depends_on) and good[name].trip >= SHAPE * good[k].trip
            for k in free
        )
    )


def _least_share(c: Candidate, material: tuple[float, float]) -> float:
    """What counts: of all energy, or of the places touched; a curve over the model's own state must show twice as much."""
    return material[c.place] * (2.0 if c.internal else 1.0)


def _rivals(other: Candidate, its: Gain, chosen: Candidate, own: Gain) -> bool:
    """Whether another explanation stays possible; a map of places is none where one number predicts unseen places as well."""
    general = not chosen.place and own.by_split.get("place", 0.0) > 0.7 * own.trip
    if other.place and general and its.trip < own.trip:
        return False
    pair = frozenset((other.name, chosen.name))
    if (pair in ALIKE and its.trip > CLOSE * own.trip) or (pair == ONE_WAY and its.trip > SHAPE * own.trip):
        return True
    return _tied(its, own)


def _tied(other: Gain, chosen: Gain) -> bool:
    """Whether held-out trips cannot tell two explanations apart."""
    difference = chosen.trips - other.trips
    error = difference.std(ddof=1) * np.sqrt(len(difference))
    return bool(difference.sum() < DOUBT * error and other.trip > 0.7 * chosen.trip)
