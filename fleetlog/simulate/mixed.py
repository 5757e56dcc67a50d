"""The trucks of one run: types that differ, drivers that differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.physics.power import Physics
from fleetlog.simulate.arrays import Index

DRIVER = dict.fromkeys(
    ("speed_factor", "max_acceleration", "max_deceleration", "max_lateral_acceleration"), 1.0
)
"""What a driver asks of a truck; power follows from the motion, whoever drives."""


@dataclass(frozen=True)
class Trucks:
    """``kinds`` are the different trucks, with what their drivers ask of them; ``of`` (V,) which each has."""

    kinds: tuple[Truck, ...]
    of: Index

    @classmethod
    def given(cls, trucks: Truck | Sequence[Truck], vehicles: int) -> Trucks:
        """One truck a vehicle; of one truck alone as many as there are, the last of them its ``others``."""
        if isinstance(trucks, Truck):
            others = [truck for truck, count in trucks.others for _ in range(count)]
            if len(others) > vehicles:
                raise DataError(
                    f"{len(others)} trucks of other types are more than the {vehicles} vehicles",
                    do="ask for more with --vehicles, or for fewer in the truck's [[fleet]]",
                )
            trucks = [replace(trucks, others=())] * (vehicles - len(others)) + others
        kinds = tuple(dict.fromkeys(trucks))
        return cls(kinds, np.array([kinds.index(trucks[v % len(trucks)]) for v in range(vehicles)], np.int32))

    def __getitem__(self, v: int) -> Truck:
        return self.kinds[int(self.of[v])]

    @property
    def envelope(self) -> Truck:
        """The truck that roads and bays are laid out for: as long, wide and strong as any, and as hard to
        turn."""

        def most(name: str) -> float:
            return max(truck.value(f"chassis.{name}") for truck in self.kinds)

        sizes = {name: most(name) for name in ("length", "width", "turn_radius", "rated_load")}
        return replace(self.kinds[0], chassis=replace(self.kinds[0].chassis, **sizes))

    def physics(self, common: Physics) -> list[Physics]:
        """Of each kind; ``common`` are the terms that hold for all."""
        return [replace(common, truck=truck) for truck in self.kinds]

    def alike(self, most: int) -> Iterator[slice]:
        """Groups of at most so many trucks, one after the other, that take the same power to move alike."""
        types = [replace(truck, drive=replace(truck.drive, **DRIVER)) for truck in self.kinds]
        kind = np.array([types.index(t) for t in types])[self.of]
        starts = np.concatenate([[0], np.flatnonzero(np.diff(kind)) + 1, [len(kind)]])
        for low, high in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
            yield from (slice(k, min(k + most, high)) for k in range(low, high, most))
