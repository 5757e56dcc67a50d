"""Fit a truck to measured runs."""

from collections.abc import Sequence
from typing import cast

from fleetlog.api import inputs
from fleetlog.api.answer import Answer, destination
from fleetlog.api.inputs import DatasetLike, MeasurementsLike, PathLike, PhysicsLike, TruckLike
from fleetlog.api.verb import verb


@verb()
def calibrate(
    measurements: MeasurementsLike, *, truck: TruckLike, physics: PhysicsLike | None = None,
    output: PathLike | None = None, overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Fit a truck to MEASUREMENTS: tables of measured runs (CSV) or recorded datasets with power.

    Parameters that the runs do not determine keep their values; the answer says which run would.

    Parameters
    ----------
    measurements : tables of runs (CSV; in Python also DataFrames), or datasets.
    truck : truck file, or name of a preset, to start from.
    output : truck file to write."""
    from fleetlog.calibrate.fit import calibrate as fitted
    from fleetlog.calibrate.report import lines, summary, truck_toml

    nominal = inputs.as_truck(truck)
    known = None if physics is None else inputs.as_physics(physics, nominal)
    read = (measurements, truck, physics)
    with destination(output, "calibrated truck", overwrite, read, folder=False) as keep:
        paths = [inputs.as_csv(m) for m in cast("Sequence[DatasetLike]", measurements)]
        fit = fitted(paths, nominal, known)
        answer = Answer("calibrate", summary(fit), lines=lines(fit), value=fit)
        answer.write = lambda file: file.write_text(truck_toml(fit), encoding="utf-8")
        return keep(answer)
