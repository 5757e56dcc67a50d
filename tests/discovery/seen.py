"""A dataset whose trajectories look different from what they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset


@dataclass(frozen=True)
class Seen:
    """A dataset as it looks when every trajectory is changed; of it, what a diagnosis reads."""

    dataset: Dataset
    change: Callable[[Trajectory], Trajectory]
    site: Site

    def __getattr__(self, name: str) -> object:
        return getattr(self.dataset, name)

    def here(self) -> Seen:
        return self

    def read(self, vehicle: str, date: str, columns: Sequence[str]) -> Trajectory:
        """One vehicle-day, changed."""
        return self.change(self.dataset.read(vehicle, date, columns))
