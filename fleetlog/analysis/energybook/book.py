"""Whole trips of one vehicle in the books:
sums of every ledger term over segments (one trip within one hour), stretches and zones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.analysis.energybook.cells import Cells, follow_cells
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.battery import BatteryModel
from fleetlog.physics.motion import Reconstruction
from fleetlog.physics.power import Physics, battery_power, cell_power, ledger, term_forces

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
    bins, bin_energy, bin_measured : (M,) [us], (M, T) and (M, 3): joules measured, joules of the model in
        that time, and its seconds.
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
    "seconds", "metres", "kilogram_metres", "returned", "traction", "braking", "loss", "measured",
    "beside_measured", "raising", "motion_variance",
)  # fmt: skip
"""``returned`` flowed back into the battery; ``traction`` and ``braking`` are drive energy where the wheels
push and are pushed; ``beside_measured`` is the model where there is a measurement; ``raising`` is lifting
alone."""


def measured_power(trajectory: Trajectory) -> tuple[Floats, str]:
    """(N,) power at the battery terminals [W] that the log gives, NaN where it gives none,
    and where it comes from.
    """
    if trajectory.has("battery_power"):
        return trajectory.floats("battery_power"), "power"
    if trajectory.has("battery_voltage") and trajectory.has("battery_current"):
        return trajectory.floats("battery_voltage") * trajectory.floats(
            "battery_current"
        ), "voltage and current"
    return np.full(len(trajectory), np.nan), "soc" if trajectory.has("soc") else "nothing"


def keep_book(
    trajectory: Trajectory, found: Reconstruction, physics: Physics, site: Site, battery: BatteryModel
) -> Book:
    """The sums of some trips of one vehicle from the motion ``found`` in them."""
    measured, source = measured_power(trajectory)
    fine, dt = found.motion, found.dt_row
    forces = term_forces(fine, physics)
    pieces = {name: watts * fine.dt for name, watts in ledger(fine, physics, forces).items()}
    joules = {name: found.rows(piece) for name, piece in pieces.items()}
    work = sum(forces.values(), np.zeros(len(fine))) * fine.speed * fine.dt
    terms, whole = tuple(joules), sum(joules.values(), np.zeros(len(dt)))
    total = np.divide(whole, dt, out=np.zeros(len(dt)), where=dt > 0.0)
    starts = _segments(trajectory)
    segment = np.cumsum(np.isin(np.arange(len(dt)), starts)) - 1
    known = np.isfinite(measured)
    drive = physics.actual_truck().drive
    sums = {
        "seconds": dt,
        "metres": found.rows(fine.speed * fine.dt),
        "kilogram_metres": found.rows(fine.payload * fine.speed * fine.dt),
        "returned": -np.minimum(whole, 0.0),
        "traction": found.rows(np.maximum(work, 0.0)) / drive.efficiency,
        "braking": found.rows(np.minimum(work, 0.0)) * drive.regeneration,
        "loss": (cell_power(total, physics.actual_truck()) - total) * dt,
        "measured": np.where(known, measured, 0.0) * dt,
        "beside_measured": np.where(known, whole, 0.0),
        "raising": np.maximum(joules.get("lift_efficiency", np.zeros(len(dt))), 0.0),
    }
    by_segment = {k: np.add.reduceat(v, starts) for k, v in sums.items()}
    by_segment["motion_variance"] = found.window_variance(
        lambda motion: battery_power(motion, physics), segment[found.row]
    )
    soc, ends = trajectory.floats("soc"), np.append(starts[1:], len(trajectory)) - 1
    stretch, stretch_sums = _by_stretch(fine, sum(pieces.values(), np.zeros(len(fine))))
    bins, bin_energy, bin_measured = _by_time(
        trajectory.time, list(joules.values()), [sums["measured"], sums["beside_measured"], known * dt]
    )
    return Book(
        trajectory.vehicle_id, terms, trajectory.trip_ids()[starts], trajectory.time[starts] // HOUR * HOUR,
        _reduced(list(joules.values()), starts), by_segment,
        np.maximum.reduceat(total, starts), np.stack([soc[starts], soc[ends]], axis=1),
        np.stack([trajectory.time[starts], trajectory.time[ends]], axis=1), stretch, stretch_sums,
        _by_zone(fine, list(pieces.values()), site), bins, bin_energy, bin_measured,
        follow_cells(starts, total, dt, soc, trajectory.floats("ambient_temperature"), battery), source,
    )  # fmt: skip


def _segments(trajectory: Trajectory) -> NDArray[np.intp]:
    """First row of every segment: a new trip or a new hour."""
    trip, hour = trajectory.trip_ids(), trajectory.time // HOUR
    return np.flatnonzero(np.concatenate([[True], (np.diff(trip) != 0) | (np.diff(hour) != 0)]))


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
        inside = zone.contains(motion.x, motion.y)
        way = (motion.speed * motion.dt)[inside].sum()
        out.append([*(row[inside].sum() for row in joules), way, motion.dt[inside].sum()])
    return np.array(out).reshape(len(site.zones), len(joules) + 2)


def _by_time(time: Ints, joules: list[Floats], measured: list[Floats]) -> tuple[Ints, Floats, Floats]:
    minute = time // BIN
    starts = np.flatnonzero(np.concatenate([[True], np.diff(minute) != 0]))
    return minute[starts] * BIN, _reduced(joules, starts), _reduced(measured, starts)


def _reduced(rows: list[Floats], starts: NDArray[np.intp]) -> Floats:
    """(S, T) sums of T columns over the segments that begin at ``starts``."""
    return np.stack([np.add.reduceat(row, starts) for row in rows], axis=1)
