"""One vehicle, stretch by stretch: cleaned, placed, matched, cut into trips, written."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.site import MapFrame, Site
from fleetlog.core.trajectory import Ints, Trajectory
from fleetlog.importers.base import GEOGRAPHIC
from fleetlog.ingest import clean
from fleetlog.ingest.channels import join_channels
from fleetlog.ingest.derive import derive_motion, derive_power, pace_ratio
from fleetlog.ingest.edges import Edges, log_has_edges
from fleetlog.ingest.fixes import fill_positions, release_held
from fleetlog.ingest.place import check_place, into_site, looks_like_degrees, place, with_frame
from fleetlog.ingest.rejects import NAME, Rejects
from fleetlog.ingest.rows import CHANNEL, HELD, INTERNAL, STUCK, join, with_own_columns, without
from fleetlog.ingest.spill import WINDOW_ROWS, Down
from fleetlog.ingest.summary import MOST_PACES, Outcome
from fleetlog.store.trips import trip_ids
from fleetlog.store.writer import DatasetWriter
from fleetlog.store.written import Before

if TYPE_CHECKING:
    from fleetlog.roads.matching import MatchParameters

DEGREES = "x and y look like degrees: if they are, map them in a profile to longitude and latitude"
ESTIMATE_ROWS = 2000
"""The parameters of matching are estimated on the first stretch that has this many rows."""
OVERLAP = 5000
"""Rows kept back where a stretch has to end within a trip."""


@dataclass(frozen=True)
class Plan:
    """What is the same for all vehicles of an import.

    ``folder`` is that of the dataset being written, ``scratch`` takes files of the import's own; ``names``
    are those of the logs, ``own`` their own columns, ``positioned`` the vehicles that have positions.
    """

    folder: Path
    scratch: Path
    site: Site
    names: list[str]
    own: dict[str, bool]
    positioned: frozenset[str]
    before: Before
    """What the dataset holds that is added to."""
    every: MapFrame | None = None
    """The frame of all rows."""
    parameters: MatchParameters | None = None
    notes: tuple[str, ...] = ()
    """What the first rows look like."""


def import_vehicle(plan: Plan, job: tuple[int, str, Down]) -> Outcome:
    """Clean, place, match and write the rows of one vehicle."""
    number, vehicle, down = job
    rejects = Rejects(plan.scratch / f"vehicle-{number}-{NAME}", plan.names)
    work = VehicleImport(plan, rejects, plan.before.next_trip(vehicle))
    for rows, last in down.windows(vehicle):
        if vehicle in plan.positioned:
            work.take(rows, last=last)
        else:
            rejects.refuse(rows, np.ones(len(rows), bool), "no log has a position of this vehicle")
    return work.outcome()


def probe(plan: Plan, down: Down) -> Plan:
    """The plan with the site's frame and the parameters of matching, from the first stretches of the logs.

    :class:`~fleetlog.errors.DataError` where the logs are of another place than the site.
    """
    first = True
    for vehicle in (v for v in down.vehicles if v in plan.positioned):
        for rows, _ in down.windows(vehicle):
            if first:
                plan = replace(plan, site=with_frame(plan.site, rows))
            work = VehicleImport(plan, Rejects(None, plan.names))
            if first and looks_like_degrees(rows):
                plan = replace(plan, notes=(DEGREES,))
            rows = work.prepared(rows, check=first)
            first = False
            network = plan.site.network
            if network is None or log_has_edges(rows, network):
                return plan
            if len(rows) >= ESTIMATE_ROWS:
                from fleetlog.roads.matching import estimate_parameters

                return replace(plan, parameters=estimate_parameters(rows, network))
    return plan


class VehicleImport:
    """The second half of an import for one vehicle; its rows come in order of time."""

    def __init__(self, plan: Plan, rejects: Rejects, trip: int = 0) -> None:
        site, own = plan.site, plan.own
        self.every = plan.every
        self.own = own if site.frame is None else {n: t for n, t in own.items() if n not in GEOGRAPHIC}
        self.site, self.rejects = site, rejects
        self.writer = DatasetWriter(plan.folder, "recorded", site, plan.before)
        self.edges = Edges(site.network, plan.parameters) if site.network is not None else None
        tally = self.edges.tally if self.edges is not None else None
        self.out = Outcome(written=self.writer.written, edges=tally)
        self._kept_back: Trajectory | None = None
        self._first_trip = self._trip = trip
        self._trips: set[int] = set()

    def outcome(self) -> Outcome:
        """What all this came to."""
        self.out.refused, self.out.summary.trips = self.rejects.close(), len(self._trips)
        return self.out

    def prepared(self, rows: Trajectory, *, check: bool) -> Trajectory:
        """The first rows of the vehicle as they are matched; ``check`` that they are of the site's place."""
        rows = self._in_order(self._clean(rows, check=check))
        return self._derive(rows) if len(rows) else rows

    def take(self, rows: Trajectory, *, last: bool) -> None:
        """The next stretch of the vehicle, unsorted."""
        rows = self._clean(rows)
        if self._kept_back is not None and len(self._kept_back):
            rows = join([self._kept_back, rows]) if len(rows) else self._kept_back
        rows = self._in_order(rows)
        if not len(rows):
            self._kept_back = None
            return
        full = self._derive(rows)
        trips = self._trip_ids(full)
        cut = len(rows) if last else _cut(trips)
        self._write(full[:cut].with_columns(trip_id=trips[:cut]))
        self._kept_back, self._trip = (None, self._trip) if last else (rows[cut:], int(trips[cut]))

    def _clean(self, rows: Trajectory, *, check: bool = False) -> Trajectory:
        """What a row tells by itself, and channels."""
        rows = clean.sort_rows(rows)
        rows = clean.drop_impossible(rows, self.rejects)
        rows = clean.bound_values(rows, self.rejects)
        rows = into_site(rows, self.site.map_frames, self.every)
        sample = rows
        rows = place(rows, self.site)
        if check and len(rows):
            check_place(rows.floats("x"), rows.floats("y"), self.site, sample)
        if CHANNEL in rows:
            joined = join_channels(rows)
            self.out.summary.rows_joined += len(rows) - len(joined)
            return joined
        return rows

    def _in_order(self, rows: Trajectory) -> Trajectory:
        """What a row tells beside its neighbours."""
        rows = clean.drop_duplicates(clean.sort_rows(rows), self.rejects)
        return clean.drop_jumps(release_held(rows), self.rejects)

    def _derive(self, rows: Trajectory) -> Trajectory:
        rows = clean.unstick(fill_positions(rows))
        full = derive_power(derive_motion(rows))
        made = [n for n in ("speed", "heading", "battery_power") if full.has(n) and not rows.has(n)]
        if made:
            own = self.out.summary.derived_by_vehicle.setdefault(rows.vehicle_id, [])
            own += [n for n in made if n not in own]
            self.out.summary.derived = sorted(own)
        return full

    def _trip_ids(self, rows: Trajectory) -> Ints:
        own = rows.trip_ids()
        if rows.has("trip_id") and bool((own >= self._first_trip).all() and (np.diff(own) >= 0).all()):
            return own
        return trip_ids(rows, self._trip)

    def _write(self, rows: Trajectory) -> None:
        if not len(rows):
            return
        if self.edges is not None:
            rows = self.edges.match(rows)
        self._count(rows)
        self.writer.write(with_own_columns(without(rows, *INTERNAL), self.own))
        s = self.out.summary
        s.rows += len(rows)
        s.vehicles[rows.vehicle_id] = s.vehicles.get(rows.vehicle_id, 0) + len(rows)
        self._trips.update(np.unique(rows.trip_ids()).tolist())

    def _count(self, rows: Trajectory) -> None:
        """What the rows tell about the sensors."""
        self.out.stuck += int(np.nansum(rows.floats(STUCK)))
        self.out.held += int(np.nansum(rows.floats(HELD)))
        measured = "speed" not in self.out.summary.derived and len(self.out.paces) < MOST_PACES
        if measured and (pace := pace_ratio(rows)) is not None:
            self.out.paces.append(pace)


def _cut(trips: Ints) -> int:
    """Rows to write now: up to the last trip's beginning, or within it beyond memory."""
    begins = np.flatnonzero(np.diff(trips)) + 1
    if len(begins):
        return int(begins[-1])
    return max(len(trips) - OVERLAP, 0) if len(trips) > 2 * WINDOW_ROWS else 0
