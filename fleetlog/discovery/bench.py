"""What the search needs of a channel, be it energy over windows or time over stretches of road."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fleetlog.discovery.candidates import Candidate
from fleetlog.discovery.model import Found
from fleetlog.discovery.windows import Windows

Floats = NDArray[np.float64]
Columns = NDArray[np.float32]

MATERIAL = 0.02
"""A mismatch below this share of the energy (or time) it touches does not count."""
COARSE = 0.06
"""The same where rows are far apart."""


class Bench(Protocol):
    """What the search needs of a channel: windows with a recorded quantity, and what models say of it."""

    @property
    def windows(self) -> Windows:
        """Where and when."""
        ...

    @property
    def recorded(self) -> Floats:
        """(W,) the recorded energy [kJ], or time [s]."""
        ...

    @property
    def whole(self) -> NDArray[np.bool_]:
        """(W,) windows that can be used."""
        ...

    def tabulate(self, found: Found, named: list[Candidate], free: dict[str, Columns]) -> Table:
        """The residual under a model and the columns of all named candidates about it."""
        ...

    def column(self, found: Found, candidate: Candidate) -> Floats:
        """(W, p) of one named candidate about a model."""
        ...

    def effect(self, before: Found, after: Found) -> Floats:
        """(W,) that one model says more than another."""
        ...


@dataclass
class Table:
    """W windows: ``y`` recorded minus modelled energy, ``model`` the modelled one [kJ], ``groups`` (W, p) by candidate.

    ``nuisance`` are the groups of small honest errors of a truck file and a logger; ``spread`` their standard deviations.
    ``jitter`` (W,) is how much the residual power jumps from row to row [W]: motion faster than the log resolves.
    ``crude`` (W,) is what a model that is right in kind may still be off by.
    """

    windows: Windows
    y: Floats
    model: Floats
    groups: dict[str, Columns]
    nuisance: dict[str, Columns]
    spread: dict[str, Floats]
    jitter: Floats
    crude: Floats
    free: dict[str, Columns] = field(default_factory=dict)
    load: Floats | None = None
    """(W,) what a standard deviation of an unknown load adds, where loads are carried and not recorded."""


class Latest:
    """The table that was asked for last: the search comes back to the same model again and again."""

    def __init__(self) -> None:
        self._kept: tuple[Found, list[Candidate], Table] | None = None

    def table(self, found: Found, named: list[Candidate], make: Callable[[], Table]) -> Table:
        """The kept table where it is that of ``found`` and has all of ``named``, else a new one."""
        if self._kept is None or self._kept[0] is not found or any(c not in self._kept[1] for c in named):
            self.forget()
            self._kept = found, named, make()
        return self._kept[2]

    def forget(self) -> None:
        """Give its memory back."""
        self._kept = None
