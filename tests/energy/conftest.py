"""A small recorded day with a known truth."""

from __future__ import annotations

import numpy as np
import pytest
from shuttle import recorded, street, truth

from fleetlog.core.motion import Motion
from fleetlog.core.site import Site, Zone
from fleetlog.core.truck import Truck, load_truck
from fleetlog.physics.power import Physics, battery_power
from fleetlog.store.dataset import Dataset
from fleetlog.store.writer import DatasetWriter


@pytest.fixture(scope="session")
def truck() -> Truck:
    return load_truck("counterbalance-2.5t")


@pytest.fixture(scope="session")
def day(tmp_path_factory: pytest.TempPathFactory, truck: Truck) -> tuple[Dataset, Motion]:
    """Two trucks, 24 trips each, over an hour's end; power exactly that of the nominal model."""
    network = street()
    ramp = Zone("ramp", np.array([[40.0, -5], [80, -5], [80, 5], [40, 5]]))
    motion, _ = truth(truck, network, 24)
    power = battery_power(motion, Physics(truck))
    path = tmp_path_factory.mktemp("energy") / "day"
    with DatasetWriter.create(path, "recorded", Site("street", network=network, zones=(ramp,))) as writer:
        for vehicle in ("T1", "T2"):
            soc = 0.9 - np.cumsum(power * motion.dt) / (3600.0 * truck.battery.capacity_wh)
            writer.write(recorded(motion, vehicle, power, network, soc=soc))
    return Dataset(path), motion
