"""What all trucks of a recording share: site, truck type, logger, and what is concealed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cases import Case
from effects import Effect, Scope, draw
from loggers import LOGGERS, Logger, for_sensor_effects
from sites import Site
from trucks import Truck, misfiled, truck_type

SHARES = {
    "mass+": {"mass": 0.05}, "mass-": {"mass": -0.05}, "efficiency+": {"efficiency": 0.03},
    "efficiency-": {"efficiency": -0.03},
}  # fmt: skip
"""By which truck files are wrong."""


@dataclass
class World:
    """Everything that follows from a case but the drives and the noise."""

    case: Case
    site: Site
    truck: Truck
    file: Truck
    """The numbers in the truck file."""
    effects: list[Effect]
    logger: Logger

    @property
    def seconds(self) -> float:
        """From the begin of the recording to its end."""
        return 86400.0 * (self.case.days - 1) + 3600.0 * self.case.hours


def world(case: Case, given: list[Effect] | None = None) -> World:
    """Draw site, truck type and effects from the seed of a case; ``given`` effects replace drawn ones."""
    rng = np.random.default_rng(case.seed)
    site = Site.draw(case.site, rng)
    truck = truck_type(rng)
    if "wind" in case.terms:
        truck = replace(truck, drag_area=6.0)
    effects = conceal(case, site, truck) if given is None else given
    logger = for_sensor_effects(LOGGERS[case.logger], effects)
    return World(case, site, truck, misfiled(truck, SHARES.get(case.wrong, {})), effects, logger)


def conceal(case: Case, site: Site, truck: Truck) -> list[Effect]:
    """Draw the effects of a case."""
    rng = np.random.default_rng([case.seed, 6])
    scope = draw_scope(case, rng)
    busy = [int(k) for k in rng.permutation(site.central(5))]
    out = []
    for k, term in enumerate(case.terms):
        sign = (1.0, -1.0)[k % 2] if case.together == "opposite" else 0.0
        roads: tuple[int, ...] = ()
        if case.together == "road" or case.scope == "place":
            roads = (busy[0],)
        out.append(draw(term, site, truck, case.strength, case.seed, sign=sign, roads=roads, scope=scope))
    return out


def draw_scope(case: Case, rng: np.random.Generator) -> Scope:
    """Draw whom and when the effects of a case touch."""
    whole, order = case.hours * 3600.0, rng.permutation(case.vehicles)
    when = float(rng.uniform(0.35, 0.65) * whole)
    return {
        "fleet": Scope(),
        "truck": Scope(vehicles=(int(order[0]),)),
        "type": Scope(vehicles=tuple(sorted(int(k) for k in order[: case.vehicles // 2]))),
        "period": Scope(begin=when),
        "drift": Scope(begin=0.0, end=whole, drift=True),
        "place": Scope(begin=when),
    }[case.scope]
