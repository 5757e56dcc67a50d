"""Whole trips of one vehicle: sums of every term over segments (one trip in one hour), stretches, zones."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Mask
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.battery import BatteryModel, discharge
from fleetlog.physics.motion import Reconstruction
from fleetlog.physics.motion.channels import measured_power
from fleetlog.physics.power import Physics, battery_power, cell_power, ledger, term_forces

HOUR = 3_600_000_000
STRETCH = 10.0  # Length of the stretches of road that are told apart [m]
BIN = 60_000_000  # Step of the power ledger over time [us]
Columns = dict[str, Any]


@dataclass(frozen=True)
class Book:
    """Sums in joules, seconds, metres, as columns of four tables; ``J_TERM`` is the energy of a term.

    Attributes
    ----------
    segments : a row a trip and hour, in order of time.  Of the sums ``returned`` flowed back into the
        battery; ``traction`` and ``braking`` are drive energy where the wheels push and are pushed;
        ``beside_measured`` is the model where there is a measurement; ``raising`` is lifting alone.  ``peak``
        is the highest power [W], ``lowest`` the lowest voltage [V] of the model's battery, ``source`` what
        the measured energy was taken from.
    stretches : a row an edge and ``number`` of the stretch on it.
    zones : a row a zone of the site.
    bins : a row a ``BIN`` of time [us]; ``known`` are the seconds with a measurement.
    """

    segments: Columns
    stretches: Columns
    zones: Columns
    bins: Columns


def gathered(books: Sequence[Book], what: str) -> pd.DataFrame:
    """One table of all books; a term that one of them lacks is 0 there."""
    table = pd.concat([pd.DataFrame(getattr(book, what)) for book in books], ignore_index=True)
    return table.fillna({name: 0.0 for name in table.columns if name.startswith("J_")})


def _source(trajectory: Trajectory, known: Mask) -> str:
    """What the measured energy of some trips is taken from."""
    if trajectory.has("battery_power"):
        return "power"
    return "voltage and current" if known.any() else "soc" if trajectory.has("soc") else "nothing"


def keep_book(
    trajectory: Trajectory, found: Reconstruction, physics: Physics, site: Site, battery: BatteryModel
) -> Book:
    """The sums of some trips of one vehicle from the motion ``found`` in them."""
    fine, dt, measured = found.motion, found.dt_row, measured_power(trajectory)
    truck, metres, nothing = physics.actual_truck, fine.speed * fine.dt, np.zeros(len(dt))
    known = np.isfinite(measured)
    forces = term_forces(fine, physics)
    pieces = {name: watts * fine.dt for name, watts in ledger(fine, physics, forces).items()}
    joules = {f"J_{name}": found.rows(piece) for name, piece in pieces.items()}
    work = sum(forces.values(), np.zeros(len(fine))) * metres
    whole = sum(joules.values(), nothing)
    total = np.divide(whole, dt, out=nothing.copy(), where=dt > 0.0)
    time, trip, soc = trajectory.time, trajectory.trip_ids(), trajectory.floats("soc")
    new = np.append(True, (np.diff(trip) != 0) | (np.diff(time // HOUR) != 0))
    starts = np.flatnonzero(new)
    ends = np.append(starts[1:], len(time)) - 1
    compared = {
        "measured": np.where(known, measured, 0.0) * dt,
        "beside_measured": np.where(known, whole, 0.0),
    }
    sums = {
        "seconds": dt, "metres": found.rows(metres), "kilogram_metres": found.rows(fine.payload * metres),
        "returned": -np.minimum(whole, 0.0),
        "traction": found.rows(np.maximum(work, 0.0)) / truck.drive.efficiency,
        "braking": found.rows(np.minimum(work, 0.0)) * truck.drive.regeneration,
        "loss": (cell_power(total, truck) - total) * dt,
        "raising": np.maximum(joules.get("J_lift_efficiency", nothing), 0.0), **compared,
    }  # fmt: skip
    doubt = found.window_variance(lambda m: battery_power(m, physics), (np.cumsum(new) - 1)[found.row])
    segments = {
        "vehicle_id": trajectory.vehicle_id, "trip_id": trip[starts], "hour": time[starts] // HOUR * HOUR,
        **_reduced(joules | sums, starts), "motion_variance": doubt, "source": _source(trajectory, known),
        "peak": np.maximum.reduceat(total, starts), "soc_start": soc[starts], "soc_end": soc[ends],
        "start": time[starts], "end": time[ends],
        **_cells(starts, total, dt, soc, trajectory.floats("ambient_temperature"), battery),
    }  # fmt: skip
    bins = np.flatnonzero(np.append(True, np.diff(time // BIN) != 0))
    over_time = _reduced(joules | compared | {"known": known * dt}, bins)
    stretches = _by_stretch(fine, sum(pieces.values(), np.zeros(len(fine))), metres)
    inside = [zone.contains(fine.x, fine.y) for zone in site.zones]
    samples = {f"J_{name}": piece for name, piece in pieces.items()} | {"metres": metres, "seconds": fine.dt}
    zones = {name: np.array([row[z].sum() for z in inside]) for name, row in samples.items()}
    zones["zone"] = np.arange(len(inside))
    return Book(segments, stretches, zones, {"time": time[bins] // BIN * BIN, **over_time})


def _by_stretch(motion: Motion, joules: Floats, metres: Floats) -> Columns:
    """Joules and metres on every stretch of directed edge that was driven."""
    on = np.flatnonzero((motion.edge >= 0) & (motion.speed > 0.0))
    number = (np.maximum(motion.edge_offset[on], 0.0) / STRETCH).astype(np.int64)
    most = int(number.max(initial=0)) + 1
    key, inverse = np.unique(motion.edge[on] * most + number, return_inverse=True)
    edge, number = (part.astype(np.int32) for part in np.divmod(key, most))
    sums = (np.bincount(inverse, of[on], len(key)) for of in (joules, metres))
    return dict(zip(("edge", "number", "joules", "metres"), (edge, number, *sums), strict=True))


def _reduced(rows: dict[str, Floats], starts: NDArray[np.intp]) -> Columns:
    """Sums over the segments that begin at ``starts``."""
    return {name: np.add.reduceat(row, starts) for name, row in rows.items()}


def _cells(
    starts: NDArray[np.intp], power: Floats, dt: Floats, soc: Floats, temperature: Floats,
    battery: BatteryModel,
) -> Columns:  # fmt: skip
    """Discharge the battery segment by segment, each from the charge that the log gives at its start.

    Where the log gives none, from full: the voltages then are those of a full battery, and the end of charge
    is unknown.
    """
    rows = []
    for a, b in itertools.pairwise([*starts.tolist(), len(power)]):
        warm = temperature[a:b][np.isfinite(temperature[a:b])]
        mean = float(warm.mean()) if len(warm) else float("nan")
        done = discharge(power[a:b], dt[a:b], battery, float(np.nan_to_num(soc[a], nan=1.0)), mean)
        end = done.soc[-1] + 0.0 * soc[a]
        rows.append((end, done.voltage.min(), done.collapsed @ dt[a:b], done.empty @ dt[a:b]))
    names = ("soc_end_model", "lowest", "collapsed", "empty")
    return dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))
