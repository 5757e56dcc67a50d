"""From measurements to a fitted truck."""

from collections.abc import Sequence
from pathlib import Path

from fleetlog.calibrate.fit import Fit, fit
from fleetlog.calibrate.observe import Observations, of_motion, of_runs, together
from fleetlog.calibrate.runs import read_runs
from fleetlog.core.motion import join
from fleetlog.core.truck import Truck
from fleetlog.errors import InputError
from fleetlog.physics.power import Physics
from fleetlog.store.dataset import Dataset


def calibrate(measurements: Sequence[str | Path], truck: Truck, physics: Physics | None = None) -> Fit:
    """Fit a truck to datasets and CSV tables (:class:`fleetlog.calibrate.runs.Run`), ``physics`` given."""
    base = Physics(truck) if physics is None else Physics(truck, physics.values, physics.off, physics.fields)
    return fit(together([observations(Path(m), base) for m in measurements]), base)


def observations(path: Path, physics: Physics) -> Observations:
    """The measured figures of one table or dataset."""
    if path.is_dir():
        return of_dataset(Dataset(path), physics)
    if not path.is_file():
        raise InputError("no such measurements", where=path, do="give a CSV table of runs or a dataset")
    return of_runs(read_runs(path), physics.truck)


def of_dataset(dataset: Dataset, physics: Physics) -> Observations:
    """The energy of every window of a recording; see :func:`fleetlog.calibrate.observe.of_motion`."""
    from fleetlog.physics.motion import measured_channels, reconstruct

    network = dataset.site.network
    pieces = []
    for number, vehicle in enumerate(dataset.vehicles):
        rows = measured_channels(dataset.read(vehicle), dataset.meta)
        motion = reconstruct(rows, network, physics.truck).motion
        pieces.append(motion.replaced(vehicle=motion.vehicle * 0 + number))
    return of_motion(join(pieces), physics)
