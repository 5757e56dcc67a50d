"""What is compared: measured figures of runs and recordings, their deviations, and what the model gives."""

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fleetlog.core.arguments import Between
from fleetlog.core.arrays import Floats
from fleetlog.core.files import open_regular
from fleetlog.core.motion import Motion, join
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError, InputError, chosen, nearest
from fleetlog.physics.cycles import VDI_SPEED, Piece, legs, lift, run, vdi_pieces
from fleetlog.physics.motion import measured_channels, reconstruct
from fleetlog.physics.power import Physics, battery_power, ledger, term_forces
from fleetlog.store.dataset import Dataset

DEFAULT_SIGMA = 0.02  # Standard deviation of a measured figure where the table gives none, as a share of it
LEAST_SIGMA = 0.5  # ... and at least this, for runs that cost next to nothing [Wh].
WINDOW = 20.0  # Of pieces of a recording: long against the noise of a sample, short against a trip [s]
MODEL_DOUBT = 0.02  # Share by which each term may be wrong in form in a log; more rows do not average it away
BRAKING_DOUBT = 0.03  # Share of the braking work that smoothing may hide, in traction and in braking alike
BLOCK = 15  # Windows whose sum tells how much longer than a window the disagreement lasts (5 minutes)


@dataclass(frozen=True)
class Run:
    """One row of a table of measurements; a cell left blank takes the default.

    run : name.
    kind : one of ``KINDS``.
    energy : measured at the battery terminals, over all repeats [Wh];  sigma : its standard deviation [Wh].
    repeats : how often it was done.
    payload : kg.  length : of the way [m].  height : of a lift [m].
    speed : highest, or at the start of a coast-down [m/s];  end_speed : at the end of a coast-down [m/s].
    acceleration, deceleration : m/s2, the truck file's by default.
    grade : tan of the slope, uphill positive.
    duration : s, of an idle run; measured, of a coast-down (there ``sigma`` is in seconds)."""

    run: str
    kind: str
    energy: float = float("nan")
    sigma: float = float("nan")
    repeats: float = 1.0
    payload: float = 0.0
    length: float = float("nan")
    height: float = float("nan")
    speed: float = float("nan")
    end_speed: float = 0.0
    acceleration: float = float("nan")
    deceleration: float = float("nan")
    grade: float = 0.0
    duration: float = float("nan")

    @property
    def measured(self) -> float:
        """The observed figure: Wh, or s for a coast-down."""
        return self.duration if self.kind == "coast_down" else self.energy

    @property
    def deviation(self) -> float:
        """Standard deviation of the observed figure, in its unit."""
        if not np.isnan(self.sigma):
            return self.sigma
        return max(abs(DEFAULT_SIGMA * self.measured), 0.0 if self.kind == "coast_down" else LEAST_SIGMA)


def _drive(r: Run, truck: Truck) -> list[Piece]:
    """From rest to rest."""
    up = truck.drive.max_acceleration if np.isnan(r.acceleration) else r.acceleration
    down = truck.drive.max_deceleration if np.isnan(r.deceleration) else r.deceleration
    return run(r.length, r.speed, up, down)


KINDS: dict[str, tuple[tuple[str, ...], Callable[[Run, Truck], list[Piece]]]] = {
    "idle": (("energy", "duration"), lambda r, t: [Piece(r.duration)]),
    "lift": (("energy", "height"), lambda r, t: lift(r.height, t)[:1]),
    "lower": (("energy", "height"), lambda r, t: lift(r.height, t)[1:]),
    **dict.fromkeys(("drive", "stop_and_go"), (("energy", "length", "speed"), _drive)),
    **dict.fromkeys(
        ("steady", "ramp"), (("energy", "length", "speed"), lambda r, t: [Piece(r.length / r.speed, r.speed)])
    ),
    "coast_down": (("speed", "duration"), lambda r, t: []),
    "vdi2198": (("energy",), lambda r, t: vdi_pieces(t, VDI_SPEED if np.isnan(r.speed) else r.speed)),
}
"""What a row of each kind must have, and how one repeat is driven."""
POSITIVE = ("sigma", "repeats", "length", "height", "speed", "acceleration", "deceleration", "duration")
NOT_NEGATIVE = ("payload", "end_speed")
LIMITS = dict.fromkeys(POSITIVE, Between(0.0, above=True)) | dict.fromkeys(NOT_NEGATIVE, Between(0.0))


def coast_time(r: Run, physics: Physics) -> float:
    """Seconds of a coast-down: integral of m_eff dv / F(v), by the midpoint rule over 64 steps of speed."""
    steps = 64
    v = r.end_speed + (np.arange(steps) + 0.5) * (r.speed - r.end_speed) / steps
    motion = Motion.of(steps, speed=v, slope=np.arctan(r.grade), payload=r.payload)
    resisting = sum(term_forces(motion, physics).values(), np.zeros(steps))
    pushed = motion.replaced(acceleration=np.ones(steps))
    mass = sum(term_forces(pushed, physics).values(), np.zeros(steps)) - resisting
    # Downhill a truck may not slow at all; a very long time stands for that.
    return float(np.sum(mass / np.maximum(resisting, 1e-6 * mass)) * (r.speed - r.end_speed) / steps)


def read_runs(path: Path) -> list[Run]:
    """The runs of a CSV table whose header names the fields of :class:`Run`."""
    known = {f.name for f in fields(Run)}
    try:
        with io.TextIOWrapper(open_regular(path), encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(line for line in stream if not line.startswith("#"))
            for column in reader.fieldnames or ():
                if column.strip() not in known:
                    raise InputError("unknown column", where=path, place=column, do=nearest(column, known))
            rows = [_run(row, path, f"row {i}") for i, row in enumerate(reader, start=1)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not readable as a table: {error}", where=path) from None
    if not rows:
        raise InputError("has no run", where=path, do="write one run per row; docs/energy.md shows how")
    return rows


def _run(row: dict[str, str | None], path: Path, place: str) -> Run:
    given = {k.strip(): v.strip() for k, v in row.items() if k is not None and v and v.strip()}
    kind = given.pop("kind", "")
    needed, _ = chosen(KINDS, kind, f"unknown kind of run {kind!r}", InputError, where=path, place=place)
    name, numbers = given.pop("run", f"{kind} {place.removeprefix('row ')}"), {}
    for column, text in given.items():
        try:
            numbers[column] = LIMITS.get(column, Between())(text)
        except ValueError as wrong:
            raise InputError(str(wrong), where=path, place=f"{place}, {column}") from None
    for column in needed:
        if column not in given:
            raise InputError(f"a run of kind {kind} needs {column!r}", where=path, place=place)
    run = Run(name, kind, **numbers)
    if run.end_speed >= run.speed:
        raise InputError("the end speed is not below the speed", where=path, place=f"{place}, end_speed")
    return run


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
    # One repeat of each, as it was driven; nothing of a coast-down, whose time is measured.
    motions = [legs(KINDS[r.kind][1](r, truck), r.payload, r.grade) for r in runs]
    whole, owner = join(motions), np.repeat(np.arange(len(runs)), [len(m) for m in motions])

    def predict(physics: Physics) -> Floats:
        joules = np.bincount(owner, battery_power(whole, physics) * whole.dt, len(runs))
        figures = zip(runs, joules * np.array([r.repeats for r in runs]) / 3600.0, strict=True)
        return np.array([coast_time(r, physics) if r.kind == "coast_down" else wh for r, wh in figures])

    measured, sigma = np.array([r.measured for r in runs]), np.array([r.deviation for r in runs])
    return Observations(measured, sigma, tuple(r.run for r in runs), predict, np.zeros((len(runs), 0)))


def of_motion(motion: Motion, physics: Physics) -> Observations:
    """The energy [Wh] of every window of a recording in which power was measured. The deviation is that of
    the windows' residuals about the nominal model (robust, after the best common factor), widened for
    disagreement that outlasts a window, so that correlated windows do not count as independent."""
    if not (known := np.isfinite(motion.power) & (motion.dt > 0.0)).any():
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
    residual = measured - factor * nominal
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    spread = max(spread, 0.5 * float(residual.std()), 1e-6)
    blocks = residual[: len(residual) // BLOCK * BLOCK].reshape(-1, BLOCK).sum(axis=1)
    single = max(float(residual.var()), 1e-18)
    effect = float(blocks.var()) / (BLOCK * single) if len(blocks) > 2 else 1.0
    sigma = np.full(count, spread * float(np.sqrt(max(effect, 1.0))))
    doubt = np.stack([summed(row) for row in _doubts(motion, physics)], axis=1)
    return Observations(measured, sigma, tuple(f"window {i}" for i in range(count)), predict, doubt)


def _doubts(motion: Motion, physics: Physics) -> Iterator[Floats]:
    """(N,) watts, one standard deviation each, by which estimated power may be off altogether."""
    forces = term_forces(motion, physics)
    yield from (MODEL_DOUBT * watts for watts in ledger(motion, physics, forces).values())
    work = sum(forces.values(), np.zeros(len(motion))) * motion.speed
    drive = physics.truck.drive
    yield BRAKING_DOUBT * np.maximum(-work, 0.0) * (1.0 / drive.efficiency - drive.regeneration)
    # The form over speed: so much more at twice the usual speed.
    moving = motion.speed[motion.speed > 0.0]
    usual = float(np.sqrt(np.mean(moving**2))) if len(moving) else 1.0
    yield MODEL_DOUBT * np.maximum(work, 0.0) / drive.efficiency * (motion.speed / usual - 1.0)


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
    """The measured figures of one table; of a dataset the energy of every window, see :func:`of_motion`."""
    if not path.is_dir():
        return of_runs(read_runs(path), physics.truck)
    dataset = Dataset(path)
    rows = (measured_channels(dataset.read(vehicle), dataset.meta) for vehicle in dataset.vehicles)
    motions = (reconstruct(each, dataset.site.network, physics.truck).motion for each in rows)
    pieces = [motion.replaced(vehicle=motion.vehicle * 0 + k) for k, motion in enumerate(motions)]
    return of_motion(join(pieces), physics)
