"""Measured runs as rows of a table: what was driven or lifted, and what it cost."""

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fleetlog.core.arguments import Between
from fleetlog.core.files import open_regular
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck
from fleetlog.errors import InputError, nearest
from fleetlog.physics.cycles import VDI_SPEED, Piece, legs, lift, run, vdi_pieces
from fleetlog.physics.power import Physics, term_forces

DEFAULT_SIGMA = 0.02  # Standard deviation of a measured figure where the table gives none, as a share of it
LEAST_SIGMA = 0.5  # ... and at least this, for runs that cost next to nothing [Wh].


@dataclass(frozen=True)
class Run:
    """One row of a table of measurements; a cell left blank takes the default.

    Attributes
    ----------
    run : name.
    kind : one of ``KINDS``.
    energy : measured at the battery terminals, over all repeats [Wh];  sigma : its standard deviation [Wh].
    repeats : how often it was done.
    payload : kg.  length : of the way [m].  height : of a lift [m].
    speed : highest, or at the start of a coast-down [m/s];  end_speed : at the end of a coast-down [m/s].
    acceleration, deceleration : m/s2, the truck file's by default.
    grade : tan of the slope, uphill positive.
    duration : s, of an idle run; measured, of a coast-down (there ``sigma`` is in seconds).
    """

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
        least = 0.0 if self.kind == "coast_down" else LEAST_SIGMA
        return max(abs(DEFAULT_SIGMA * self.measured), least)

    def motion(self, truck: Truck) -> Motion:
        """One repeat, as it was driven; nothing of a coast-down, whose time is measured."""
        return legs(KINDS[self.kind][1](self, truck), self.payload, self.grade)


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
        raise InputError("has no run", where=path, do="write one run a row; docs/energy.md shows how")
    return rows


def _run(row: dict[str, str | None], path: Path, place: str) -> Run:
    given = {k.strip(): v.strip() for k, v in row.items() if k is not None and v and v.strip()}
    kind = given.pop("kind", "")
    if kind not in KINDS:
        raise InputError(f"unknown kind of run {kind!r}", where=path, place=place, do=nearest(kind, KINDS))
    name, numbers = given.pop("run", f"{kind} {place.removeprefix('row ')}"), {}
    for column, text in given.items():
        try:
            numbers[column] = LIMITS.get(column, Between())(text)
        except ValueError as wrong:
            raise InputError(str(wrong), where=path, place=f"{place}, {column}") from None
    for column in KINDS[kind][0]:
        if column not in given:
            raise InputError(f"a run of kind {kind} needs {column!r}", where=path, place=place)
    run = Run(name, kind, **numbers)
    if run.end_speed >= run.speed:
        what = "the end speed is not below the speed"
        raise InputError(what, where=path, place=f"{place}, end_speed")
    return run
