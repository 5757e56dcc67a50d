"""Whole trips of one vehicle: sums of every term over segments (one trip in one hour), stretches, zones."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Floats, Ints, Trajectory
from fleetlog.physics.battery import BatteryModel, discharge
from fleetlog.physics.motion import Reconstruction
from fleetlog.physics.power import Physics, battery_power, cell_power, ledger, term_forces

HOUR = 3_600_000_000
STRETCH = 10.0
"""Length of the stretches of road that are told apart [m]."""
BIN = 60_000_000
"""Step of the power ledger over time [us]."""


@dataclass(frozen=True)
class Cells:
    """(S,) each: the model's state of charge at the end, lowest voltage [V], seconds collapsed and empty."""

    soc_end: Floats
    lowest: Floats
    collapsed: Floats
    empty: Floats


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

    def over_time(self, term: str) -> Floats:
        """(M,) joules of a term in each of the ``bins``."""
        known = term in self.terms
        return self.bin_energy[:, self.terms.index(term)] if known else np.zeros(len(self.bins))


SUMS = (
    "seconds", "metres", "kilogram_metres", "returned", "traction", "braking", "loss", "measured",
    "beside_measured", "raising", "motion_variance",
)  # fmt: skip
"""``returned`` flowed back into the battery; ``traction`` and ``braking`` are drive energy where the wheels
push and are pushed; ``beside_measured`` is the model where there is a measurement; ``raising`` is lifting
alone."""


def measured_power(trajectory: Trajectory) -> tuple[Floats, str]:
    """(N,) power at the battery terminals [W], NaN where the log gives none, and where it comes from."""
    if trajectory.has("battery_power"):
        return trajectory.floats("battery_power"), "power"
    if trajectory.has("battery_voltage") and trajectory.has("battery_current"):
        volts, amperes = (trajectory.floats(f"battery_{c}") for c in ("voltage", "current"))
        return volts * amperes, "voltage and current"
    return np.full(len(trajectory), np.nan), "soc" if trajectory.has("soc") else "nothing"


def keep_book(
    trajectory: Trajectory, found: Reconstruction, physics: Physics, site: Site, battery: BatteryModel
) -> Book:
    """The sums of some trips of one vehicle from the motion ``found`` in them."""
    measured, source = measured_power(trajectory)
    fine, dt, known = found.motion, found.dt_row, np.isfinite(measured)
    truck, metres, nothing = physics.actual_truck(), fine.speed * fine.dt, np.zeros(len(found.dt_row))
    forces = term_forces(fine, physics)
    pieces = {name: watts * fine.dt for name, watts in ledger(fine, physics, forces).items()}
    joules = {name: found.rows(piece) for name, piece in pieces.items()}
    work = sum(forces.values(), np.zeros(len(fine))) * metres
    whole = sum(joules.values(), nothing)
    total = np.divide(whole, dt, out=nothing.copy(), where=dt > 0.0)
    starts = _segments(trajectory)
    ends = np.append(starts[1:], len(trajectory)) - 1
    sums = {
        "seconds": dt, "metres": found.rows(metres), "kilogram_metres": found.rows(fine.payload * metres),
        "returned": -np.minimum(whole, 0.0),
        "traction": found.rows(np.maximum(work, 0.0)) / truck.drive.efficiency,
        "braking": found.rows(np.minimum(work, 0.0)) * truck.drive.regeneration,
        "loss": (cell_power(total, truck) - total) * dt, "measured": np.where(known, measured, 0.0) * dt,
        "beside_measured": np.where(known, whole, 0.0),
        "raising": np.maximum(joules.get("lift_efficiency", nothing), 0.0),
    }  # fmt: skip
    by_segment = {k: np.add.reduceat(v, starts) for k, v in sums.items()}
    segment = np.cumsum(np.isin(np.arange(len(dt)), starts)) - 1
    by_segment["motion_variance"] = found.window_variance(
        lambda motion: battery_power(motion, physics), segment[found.row]
    )
    soc, time, each = trajectory.floats("soc"), trajectory.time, list(joules.values())
    stretch, stretch_sums = _by_stretch(fine, sum(pieces.values(), np.zeros(len(fine))))
    bins = np.flatnonzero(np.append(True, np.diff(time // BIN) != 0))
    compared = [sums["measured"], sums["beside_measured"], known * dt]
    return Book(
        trajectory.vehicle_id, tuple(joules), trajectory.trip_ids()[starts], time[starts] // HOUR * HOUR,
        _reduced(each, starts), by_segment, np.maximum.reduceat(total, starts),
        np.stack([soc[starts], soc[ends]], axis=1), np.stack([time[starts], time[ends]], axis=1), stretch,
        stretch_sums, _by_zone(fine, list(pieces.values()), site), time[bins] // BIN * BIN,
        _reduced(each, bins), _reduced(compared, bins),
        follow_cells(starts, total, dt, soc, trajectory.floats("ambient_temperature"), battery), source,
    )  # fmt: skip


def _segments(trajectory: Trajectory) -> NDArray[np.intp]:
    """First row of every segment: a new trip or a new hour."""
    trip, hour = trajectory.trip_ids(), trajectory.time // HOUR
    return np.flatnonzero(np.append(True, (np.diff(trip) != 0) | (np.diff(hour) != 0)))


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


def _reduced(rows: list[Floats], starts: NDArray[np.intp]) -> Floats:
    """(S, T) sums of T columns over the segments that begin at ``starts``."""
    return np.stack([np.add.reduceat(row, starts) for row in rows], axis=1)


def follow_cells(
    starts: NDArray[np.intp], power: Floats, dt: Floats, soc: Floats, temperature: Floats,
    battery: BatteryModel,
) -> Cells:  # fmt: skip
    """Discharge the battery segment by segment, each from the charge that the log gives at its start.

    Where the log gives none, from full: the voltages then are those of a full battery, and the end of charge
    is unknown.
    """
    rows = []
    for a, b in itertools.pairwise([*starts.tolist(), len(power)]):
        known = np.isfinite(soc[a])
        warm = temperature[a:b][np.isfinite(temperature[a:b])]
        mean = float(warm.mean()) if len(warm) else float("nan")
        done = discharge(power[a:b], dt[a:b], battery, float(soc[a]) if known else 1.0, mean)
        end = done.soc[-1] if known else np.nan
        rows.append((end, done.voltage.min(), done.collapsed @ dt[a:b], done.empty @ dt[a:b]))
    return Cells(*np.array(rows, dtype=np.float64).T)
