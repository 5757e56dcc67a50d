"""Values that hold for some vehicles, or for some time, in place of the fleet's."""

from dataclasses import dataclass, field

import numpy as np

from fleetlog.physics.field import Field
from fleetlog.physics.term import Floats, Values


@dataclass(frozen=True)
class Own:
    """``values[term]`` and ``fields[term]`` of some vehicles, or of some time."""

    values: dict[str, Values]
    vehicles: tuple[str, ...] | None = None  # Names; None: all
    begin: float = -np.inf  # [s since 1970]
    until: float = np.inf
    drift: bool = False  # They come in evenly from ``begin`` to ``until``, and hold after it
    fields: dict[str, Field] = field(default_factory=dict)

    @property
    def timed(self) -> bool:
        """Whether they hold for a time only."""
        return bool(np.isfinite(self.begin) or np.isfinite(self.until))


def share(time: Floats, begin: float, until: float, drift: bool) -> Floats:
    """Return how far something holds at some times, (N,): 1 from ``begin`` to ``until``, or growing to 1
    over them."""
    if drift:
        return np.asarray(np.clip((time - begin) / (until - begin), 0.0, 1.0))
    return np.asarray((time >= begin) & (time < until), dtype=float)
