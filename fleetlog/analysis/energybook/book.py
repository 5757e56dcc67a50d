"""Whole trips of one vehicle in the books: sums of every ledger term over segments (one trip within one hour), stretches and zones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.analysis.energybook.cells import Cells, follow_cells
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.battery import BatteryModel
from fleetlog.physics.power import Physics, cell_power, ledger, term_forces
from fleetlog.physics.refine import refined, sampled
from fleetlog.physics.term import GRAVITY

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
HOUR = 3_600_000_000
STRETCH = 10.0
"""Length of the stretches of road that are told apart [m]."""
BIN = 60_000_000
"""Step of the power ledger over time [us]."""


@dataclass(frozen=True)
class Book:
    """Sums in joules, seconds, metres; S segments in order of time.

    Attributes
    ----------
    vehicle : its id.  terms : names of the ledger's rows.
    trip, hour : (S,) trip id and start of the hour [us].
    energy : (S, T) by term.  sums : (S,) by name, see ``SUMS``.  peak : (S,) highest power [W].
    soc : (S, 2) first and last state of charge that the log gives, NaN where none.
    span : (S, 2) first and last time [us].
    stretch, stretch_sums : (B, 2) edge and number of the stretch on it, and (B, 2) joules and metres.
    zones : (Z, T + 2) joules by term, metres, seconds.
    bins, bin_energy, bin_measured : (M,) [us], (M, T) and (M, 2) joules: measured, and seconds with a measurement.
    cells : what the battery went through.
    source : what the measured energy was taken from.
    """

    vehicle: str
    terms: tuple[str, ...]
    trip: Ints
    hour: Ints
    energy: Floats
    sums: dict[str, Floats]
    peak: Floats
    soc: Floats
    span: Ints
    stretch: NDArray[np.int32]
    stretch_sums: Floats
    zones: Floats
    bins: Ints
    bin_energy: Floats
    bin_measured: Floats
    cells: Cells
    source: str


SUMS = (
    "seconds", "metres", "kilogram_metres", "returned", "traction", "braking", "loss", "measured", "beside_measured",
    "raising", "motion_variance",
)  # fmt: skip
"""``returned`` flowed back into the battery; ``traction`` and ``braking`` are drive energy where the wheels push and are pushed;
``beside_measured`` is the model where there is a measurement; ``raising`` is lifting alone."""


def measured_power(trajectory: Trajectory) -> tuple[Floats, str]:
    """(N,) power at the battery terminals [W] that the log gives, NaN where it gives none, and where it comes from."""
    if trajectory.has("battery_power"):
        return trajectory.floats("battery_power"), "power"
    if trajectory.has("battery_voltage") and trajectory.has("battery_current"):
        return trajectory.floats("battery_voltage") * trajectory.floats(
            "battery_current"
        ), "voltage and current"
    return np.full(len(trajectory), np.nan), "soc" if trajectory.has("soc") else "nothing"


def keep_book(
    trajectory: Trajectory,
    motion: Motion,
    speed_sd: Floats,
    physics: Physics,
    site: Site,
    battery: BatteryModel,
) -> Book:
    """The sums of some trips of one vehicle; ``motion`` has a sample for each row, its speed good to ``speed_sd`` [m/s]."""
    measured, source = measured_power(trajectory)
    fine, steps = refined(motion)
    forces = term_forces(fine, physics)
    rows = {name: sampled(watts, steps) for name, watts in ledger(fine, physics, forces).items()}
    work = sum(forces.values(), np.zeros(len(fine))) * fine.speed
    terms = tuple(rows)
    total = sum(rows.values(), np.zeros(len(motion)))
    dt = motion.dt
    joules = [watts * dt for watts in rows.values()]
    starts = _segments(trajectory)
    known = np.isfinite(measured)
    sums = {
        "seconds": dt, "metres": motion.speed * dt, "kilogram_metres": motion.payload * motion.speed * dt,
        "returned": -np.minimum(total, 0.0) * dt, **_drive(work, physics, steps, dt),
        "loss": (cell_power(total, physics.actual_truck()) - total) * dt,
        "measured": np.where(known, measured, 0.0) * dt, "beside_measured": np.where(known, total, 0.0) * dt,
        "raising": np.maximum(rows.get("lift_efficiency", np.zeros(len(dt))), 0.0) * dt,
        "motion_variance": _motion_variance(motion, speed_sd, physics),
    }  # fmt: skip
    soc, ends = trajectory.floats("soc"), np.append(starts[1:], len(trajectory)) - 1
    stretch, stretch_sums = _by_stretch(motion, total * dt)
    bins, bin_energy, bin_measured = _by_time(trajectory.time, joules, sums["measured"], known * dt)
    return Book(
        trajectory.vehicle_id, terms, trajectory.trip_ids()[starts], trajectory.time[starts] // HOUR * HOUR,
        _reduced(joules, starts), {k: np.add.reduceat(v, starts) for k, v in sums.items()},
        np.maximum.reduceat(total, starts), np.stack([soc[starts], soc[ends]], axis=1),
        np.stack([trajectory.time[starts], trajectory.time[ends]], axis=1), stretch, stretch_sums,
        _by_zone(motion, joules, site), bins, bin_energy, bin_measured,
        follow_cells(starts, total, dt, soc, motion.ambient_temperature, battery), source,
    )  # fmt: skip


def _segments(trajectory: Trajectory) -> NDArray[np.intp]:
    """First row of every segment: a new trip or a new hour."""
    trip, hour = trajectory.trip_ids(), trajectory.time // HOUR
    return np.flatnonzero(np.concatenate([[True], (np.diff(trip) != 0) | (np.diff(hour) != 0)]))


def _drive(work: Floats, physics: Physics, steps: int, dt: Floats) -> dict[str, Floats]:
    """(N,) joules of drive where the wheels push, and where they are pushed (<= 0), of the power at the wheel."""
    truck = physics.actual_truck().drive
    return {
        "traction": sampled(np.maximum(work, 0.0), steps) / truck.efficiency * dt,
        "braking": sampled(np.minimum(work, 0.0), steps) * truck.regeneration * dt,
    }


def _motion_variance(motion: Motion, speed_sd: Floats, physics: Physics) -> Floats:
    """(N,) squared joules that the doubt about each row's speed puts into the sum.

    The derivative of sum(conversion F v dt) by the speed of one row: kinetic energy telescopes while the conversion stays
    the same, so doubt counts where traction turns into braking, and for the way driven.  Rows are taken as independent.
    """
    truck = physics.actual_truck()
    mass = truck.chassis.mass + motion.payload
    resisting = mass * GRAVITY * (truck.resistance.rolling + np.sin(motion.slope))
    force = mass * motion.acceleration + resisting
    conversion = np.where(force >= 0.0, 1.0 / truck.drive.efficiency, truck.drive.regeneration)
    v = motion.speed
    kinetic = np.zeros(len(v))
    kinetic[1:-1] = conversion[1:-1] * (v[2:] - v[:-2]) + conversion[:-2] * v[:-2] - conversion[2:] * v[2:]
    slope = np.where(v > 0.0, 0.5 * mass * kinetic + conversion * resisting * motion.dt, 0.0)
    return np.square(slope * speed_sd)


def _by_stretch(motion: Motion, joules: Floats) -> tuple[NDArray[np.int32], Floats]:
    """Joules and metres on every stretch of directed edge that was driven."""
    on = np.flatnonzero((motion.edge >= 0) & (motion.speed > 0.0))
    number = (np.maximum(motion.edge_offset[on], 0.0) / STRETCH).astype(np.int64)
    most = int(number.max(initial=0)) + 1
    key, inverse = np.unique(motion.edge[on] * most + number, return_inverse=True)
    metres = (motion.speed * motion.dt)[on]
    sums = [np.bincount(inverse, weights, len(key)) for weights in (joules[on], metres)]
    return np.stack([key // most, key % most], axis=1).astype(np.int32), np.stack(sums, axis=1)


def _by_zone(motion: Motion, joules: list[Floats], site: Site) -> Floats:
    out = []
    for zone in site.zones:
        inside = in_polygon(zone.polygon, motion.x, motion.y)
        way = (motion.speed * motion.dt)[inside].sum()
        out.append([*(row[inside].sum() for row in joules), way, motion.dt[inside].sum()])
    return np.array(out).reshape(len(site.zones), len(joules) + 2)


def in_polygon(polygon: Floats, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """(N,) whether each point lies within a polygon ((n, 2), closed or not): odd number of edges to its right."""
    inside = np.zeros(len(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        across = (y0 > y) != (y1 > y)
        inside ^= across & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return inside


def _by_time(
    time: Ints, joules: list[Floats], measured: Floats, known: Floats
) -> tuple[Ints, Floats, Floats]:
    minute = time // BIN
    starts = np.flatnonzero(np.concatenate([[True], np.diff(minute) != 0]))
    return minute[starts] * BIN, _reduced(joules, starts), _reduced([measured, known], starts)


def _reduced(rows: list[Floats], starts: NDArray[np.intp]) -> Floats:
    """(S, T) sums of T columns over the segments that begin at ``starts``."""
    return np.stack([np.add.reduceat(row, starts) for row in rows], axis=1)
