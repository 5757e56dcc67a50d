"""The same mission as a recording.

Each truck drives the recorded trips at the recorded times, as the model would: each by itself, so that what
differs from the recording, trip by trip, is the physics and not the traffic, or in one another's way.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.physics.motion import measured_channels, reconstruct
from fleetlog.physics.power import Physics
from fleetlog.simulate.retrace import VehicleReplay
from fleetlog.simulate.track import lane_shift
from fleetlog.store.dataset import Dataset
from fleetlog.store.writer import DatasetWriter

Progress = Callable[[float, float], None]


@dataclass
class MissionSummary:
    """How replay and recording compare over all trips of some length."""

    vehicles: int
    trips: int
    rows: int
    distance_ratio: float
    duration_ratio: float
    energy_ratio: float
    own_path: int
    """Trips off the roads, which follow their recorded positions."""
    lost_share: float | None = None
    """Of the travel time, lost to other trucks; None where each drives by itself."""
    let_past: int | None = None
    """How often a truck was let past another, as each waited for the other."""


def replay(
    dataset: Dataset, truck: Truck, writer: DatasetWriter, physics: Physics | None = None,
    progress: Progress | None = None, together: bool = False,
) -> MissionSummary:  # fmt: skip
    """Drive every recorded trip of ``dataset`` through the model, under the same vehicle and trip ids.

    Rows come at the recorded interval.  Loads, fork heights, charging and temperature are the recorded ones,
    shifted to the simulated arrival; where a trip takes longer than it took, the next one sets off later.
    ``together`` the trucks keep to their lanes and wait for one another (:mod:`fleetlog.simulate.together`).
    """
    replays = _replays(dataset, truck, writer, physics or Physics(truck))
    lost, past = None, None
    if together:
        replays = iter(found := list(replays))
        lost, past = _together(found, truck)
    total, rows, trips, own = np.zeros(6), 0, 0, 0
    for i, one in enumerate(replays):
        one.run()
        driven = [t.leg for t in one.trips if t.leg is not None]
        total, rows, trips = total + one.totals, rows + one.written, trips + len(driven)
        own += sum(bool((leg.path.edge < 0).all()) for leg in driven)
        if progress is not None:
            progress(float(i + 1), float(len(dataset.vehicles)))
    if not trips:
        do = "import it with speed or denser positions"
        raise DataError("the recording has no trip", where=dataset.path, do=do)
    distance, duration, energy = (float(b / a) if a > 0.0 else float("nan") for a, b in total.reshape(2, 3).T)
    return MissionSummary(len(dataset.vehicles), trips, rows, distance, duration, energy, own, lost, past)


def _replays(
    dataset: Dataset, truck: Truck, writer: DatasetWriter, physics: Physics
) -> Iterator[VehicleReplay]:
    site = dataset.site
    for vehicle in dataset.vehicles:
        recorded = dataset.read(vehicle)
        if len(recorded) > 1:
            found = reconstruct(measured_channels(recorded, dataset.meta), site.network, truck)
            yield VehicleReplay(recorded, found, site, physics.of(vehicle, recorded.time[0] * 1e-6), writer)


def _together(replays: list[VehicleReplay], truck: Truck) -> tuple[float, int]:
    from fleetlog.simulate.together import meet_again

    for one in replays:
        if one.site.network is not None:
            one.keep_to_lanes(lane_shift(one.site.network, truck, one.site.traffic))
    return meet_again(replays, truck)
