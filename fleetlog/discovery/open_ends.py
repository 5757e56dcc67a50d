"""What a field that was found without a map may be instead."""

from __future__ import annotations

from fleetlog.discovery.select import Choice
from fleetlog.discovery.squares import Squares
from fleetlog.discovery.task import Task

DRIVING = {
    "acceleration": "regeneration",
    "curvature": "cornering_resistance",
    "speed": "viscous_drag",
}
"""Variables of driving that go with places, and the term that each may stand for."""
MOMENT = 0.7
"""Share of a slope's gain that a floor, which gives nothing back, may have before the slope is in doubt."""


def left_open(task: Task, choice: Choice) -> list[str]:
    """What else a field without a map may be, beside the terms that trips cannot tell from it.

    Slope of roads passed once: a load that was there for a while, unless the road gave back energy.  A floor can take energy as
    a hill can, and give none; where it predicts nearly as well, little came back.
    Anything even in direction: what drivers do there, where a curve over their driving predicts as well.
    """
    term, own = choice.candidate.term, choice.gain.trip
    if term is None or not term.field or not isinstance(task.floor, Squares):
        return []
    if not term.odd:
        louder = [k for k, g in choice.rivals.items() if k.startswith("force by ") and g.trip >= own]
        return [t for v, t in DRIVING.items() if f"force by {v}" in louder and t not in choice.tied]
    floor = choice.rivals.get("surface_resistance")
    once = task.recording.windows.pieces and floor is not None and floor.trip > MOMENT * own
    return ["auxiliary_load"] if once else []
