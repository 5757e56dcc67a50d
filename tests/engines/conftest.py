"""A small fleet over midnight, as a dataset and as logs."""

import numpy as np
import pytest

from fleetlog.core.truck import load_truck
from fleetlog.roads import load_site
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.tasks import Demand
from fleetlog.store import Dataset, DatasetWriter

START = int(np.datetime64("2026-03-02T23:40:00", "us").astype(np.int64))
COLUMNS = ("x", "y", "speed", "payload", "fork_height", "battery_power", "soc")


@pytest.fixture(scope="session")
def site(project_root):
    return load_site(project_root / "sample_data" / "site.toml")[0]


@pytest.fixture(scope="session")
def truck(project_root):
    return load_truck(project_root / "sample_data" / "truck.toml")


@pytest.fixture(scope="session")
def fleet(tmp_path_factory, site, truck):
    folder = tmp_path_factory.mktemp("fleet") / "dataset"
    with DatasetWriter.create(folder, "simulated", site) as writer:
        simulate(site, truck, writer, Settings(vehicles=6, duration=2400.0, start=START, seed=3), Demand())
    return Dataset(folder)


@pytest.fixture(scope="session")
def logs(tmp_path_factory, fleet):
    """One CSV a truck; one row of one of them is damaged."""
    folder = tmp_path_factory.mktemp("logs")
    for number, vehicle in enumerate(fleet.vehicles):
        t = fleet.read(vehicle, columns=COLUMNS)
        lines = [f"vehicle_id,timestamp,{','.join(COLUMNS)}"]
        for row, moment in enumerate(t.time.astype("datetime64[us]").tolist()):
            values = ",".join(f"{t.floats(c)[row]:.3f}" for c in COLUMNS)
            lines.append(f"{vehicle},{moment.isoformat()}Z,{values}")
        if number == 2:
            lines[5] = lines[5].replace(vehicle, vehicle).replace("Z,", "?,")
        (folder / f"{vehicle}.csv").write_text("\n".join(lines) + "\n")
    return folder
