"""What is compared: measured figures with their deviations, and the same figures as the model makes them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetlog.calibrate.runs import Run, coast_time, read_runs
from fleetlog.core.arrays import Floats
from fleetlog.core.motion import Motion, join
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError, InputError
from fleetlog.physics.power import Physics, battery_power, ledger, term_forces
from fleetlog.store.dataset import Dataset

WINDOW = 20.0
"""Pieces that a recording is cut into: long against the noise of one sample, short against a trip [s]."""
MODEL_DOUBT = 0.02  # Share by which each term may be wrong in form in a log; more rows do not average it away
BRAKING_DOUBT = 0.03  # Share of the braking work that smoothing may hide, in traction and in braking alike
BLOCK = 15  # Windows whose sum tells how much longer than a window the disagreement lasts (5 minutes)


@dataclass(frozen=True)
class Observations:
    """M figures, deviations and the model of them; ``doubt`` (M, D): D patterns by which all may be off."""

    measured: Floats
    sigma: Floats
    labels: tuple[str, ...]
    predict: Callable[[Physics], Floats]
    doubt: Floats

    def __len__(self) -> int:
        return len(self.measured)


def of_runs(runs: list[Run], truck: Truck) -> Observations:
    """One figure a run; ``truck`` says how fast it drives and lifts where a run does not."""
    motions = [r.motion(truck) for r in runs]
    whole, owner = join(motions), np.repeat(np.arange(len(runs)), [len(m) for m in motions])
    repeats = np.array([r.repeats for r in runs])

    def predict(physics: Physics) -> Floats:
        joules = np.bincount(owner, battery_power(whole, physics) * whole.dt, len(runs))
        figures = zip(runs, joules * repeats / 3600.0, strict=True)
        return np.array([coast_time(r, physics) if r.kind == "coast_down" else wh for r, wh in figures])

    measured, sigma = np.array([r.measured for r in runs]), np.array([r.deviation for r in runs])
    return Observations(measured, sigma, tuple(r.run for r in runs), predict, np.zeros((len(runs), 0)))


def of_motion(motion: Motion, physics: Physics) -> Observations:
    """The energy [Wh] of every window of a recording in which power was measured.

    The deviation is that of the windows' residuals about the nominal model (robust, after the best common
    factor), widened for disagreement that outlasts a window, so that correlated windows do not count as
    independent.
    """
    known = np.isfinite(motion.power) & (motion.dt > 0.0)
    if not known.any():
        do = "calibrate needs one of them"
        raise DataError("the recording has neither power nor voltage and current", do=do)
    motion = motion[known]
    # A window never crosses from one trip or vehicle to the next.
    key = np.stack([motion.vehicle, motion.trip, np.floor(motion.time / WINDOW).astype(np.int64)])
    window = np.cumsum(np.any(np.diff(key, axis=1, prepend=key[:, :1]) != 0, axis=0))
    count = int(window[-1]) + 1

    def summed(power: Floats) -> Floats:
        return np.bincount(window, power * motion.dt, count) / 3600.0

    def predict(at: Physics) -> Floats:
        return summed(battery_power(motion, at))

    measured, nominal = summed(motion.power), predict(physics)
    factor = float(nominal @ measured) / max(float(nominal @ nominal), 1e-12)
    sigma = _deviation(measured - factor * nominal)
    doubt = np.stack([summed(row) for row in _doubts(motion, physics)], axis=1)
    labels = tuple(f"window {i}" for i in range(count))
    return Observations(measured, np.full(count, sigma), labels, predict, doubt)


def _doubts(motion: Motion, physics: Physics) -> list[Floats]:
    """(N,) watts, one standard deviation each, by which estimated power may be off altogether."""
    forces = term_forces(motion, physics)
    rows = [MODEL_DOUBT * watts for watts in ledger(motion, physics, forces).values()]
    work = sum(forces.values(), np.zeros(len(motion))) * motion.speed
    drive = physics.truck.drive
    rows.append(BRAKING_DOUBT * np.maximum(-work, 0.0) * (1.0 / drive.efficiency - drive.regeneration))
    # The form over speed: so much more at twice the usual speed.
    moving = motion.speed[motion.speed > 0.0]
    usual = float(np.sqrt(np.mean(moving**2))) if len(moving) else 1.0
    rows.append(MODEL_DOUBT * np.maximum(work, 0.0) / drive.efficiency * (motion.speed / usual - 1.0))
    return rows


def _deviation(residual: Floats) -> float:
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    spread = max(spread, 0.5 * float(residual.std()), 1e-6)
    blocks = residual[: len(residual) // BLOCK * BLOCK].reshape(-1, BLOCK).sum(axis=1)
    single = max(float(residual.var()), 1e-18)
    effect = float(blocks.var()) / (BLOCK * single) if len(blocks) > 2 else 1.0
    return spread * float(np.sqrt(max(effect, 1.0)))


def together(parts: list[Observations]) -> Observations:
    """All figures of several measurements as one; the patterns of doubt of one say nothing of another."""
    from scipy.linalg import block_diag

    return Observations(
        np.concatenate([p.measured for p in parts]), np.concatenate([p.sigma for p in parts]),
        tuple(label for p in parts for label in p.labels),
        lambda physics: np.concatenate([p.predict(physics) for p in parts]),
        block_diag(*(p.doubt for p in parts)),
    )  # fmt: skip


def observations(path: Path, physics: Physics) -> Observations:
    """The measured figures of one table or dataset."""
    if path.is_dir():
        return of_dataset(Dataset(path), physics)
    if not path.is_file():
        raise InputError("no such measurements", where=path, do="give a CSV table of runs or a dataset")
    return of_runs(read_runs(path), physics.truck)


def of_dataset(dataset: Dataset, physics: Physics) -> Observations:
    """The energy of every window of a recording; see :func:`of_motion`."""
    from fleetlog.physics.motion import measured_channels, reconstruct

    pieces = []
    for number, vehicle in enumerate(dataset.vehicles):
        rows = measured_channels(dataset.read(vehicle), dataset.meta)
        motion = reconstruct(rows, dataset.site.network, physics.truck).motion
        pieces.append(motion.replaced(vehicle=motion.vehicle * 0 + number))
    return of_motion(join(pieces), physics)
