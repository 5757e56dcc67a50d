"""One vehicle after the other, stretch by stretch: cleaned, placed, matched, cut into trips, written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.site import MapFrame, Site
from fleetlog.core.trajectory import Ints, Trajectory
from fleetlog.importers.base import GEOGRAPHIC
from fleetlog.ingest import clean
from fleetlog.ingest.channels import join_channels
from fleetlog.ingest.derive import derive_motion, derive_power, pace_ratio, suspect_unit
from fleetlog.ingest.edges import Edges
from fleetlog.ingest.fixes import fill_positions, release_held
from fleetlog.ingest.place import check_place, into_site, looks_like_degrees, place
from fleetlog.ingest.rejects import Rejects
from fleetlog.ingest.rows import CHANNEL, HELD, INTERNAL, STUCK, join, with_own_columns, without
from fleetlog.ingest.spill import WINDOW_ROWS
from fleetlog.ingest.summary import ImportSummary
from fleetlog.store.trips import trip_ids

if TYPE_CHECKING:
    from fleetlog.store.writer import DatasetWriter

OVERLAP = 5000
"""Rows kept back where a stretch has to end within a trip."""


class VehicleImport:
    """The second half of an import; rows come vehicle by vehicle in order of time."""

    def __init__(
        self,
        site: Site,
        writer: DatasetWriter,
        rejects: Rejects,
        summary: ImportSummary,
        own: dict[str, bool],
        every: MapFrame | None = None,
    ) -> None:
        self.every = every
        self.own = own if site.frame is None else {n: t for n, t in own.items() if n not in GEOGRAPHIC}
        self.site, self.writer, self.rejects, self.summary = site, writer, rejects, summary
        self.edges = Edges(site.network) if site.network is not None else None
        self._kept_back: Trajectory | None = None
        self._trip = 0
        self._stuck = self._held = 0
        self._paces: list[float] = []
        self._checked = False
        self._derived: set[str] = set()
        self._trips: set[tuple[str, int]] = set()
        self._span: list[int] = []

    def take(self, rows: Trajectory, *, last: bool) -> None:
        """The next stretch of the vehicle, unsorted; after the ``last`` one comes another vehicle."""
        rows = self._clean(rows)
        if self._kept_back is not None and len(self._kept_back):
            rows = join([self._kept_back, rows]) if len(rows) else self._kept_back
        rows = clean.drop_duplicates(clean.sort_rows(rows), self.rejects)
        rows = clean.drop_jumps(release_held(rows), self.rejects)
        if not len(rows):
            self._kept_back, self._trip = None, 0 if last else self._trip
            return
        full = self._derive(rows)
        trips = self._trip_ids(full)
        cut = len(rows) if last else _cut(trips)
        self._write(full[:cut].with_columns(trip_id=trips[:cut]))
        self._kept_back, self._trip = (None, 0) if last else (rows[cut:], int(trips[cut]))

    def end(self) -> None:
        """Complete the summary."""
        s = self.summary
        s.derived = sorted(self._derived)
        s.trips = len(self._trips)
        if self._stuck:
            s.notes.append(
                f"{self._stuck:,} values of speed, power or current are unknown: their sensor was stuck"
            )
        if self._held:
            s.notes.append(
                f"{self._held:,} rows repeat a position while the truck moves: "
                "placed between the fixes by the distance driven"
            )
        if unit := suspect_unit(self._paces):
            s.notes.append(
                f"the speed is about {unit[1]:.2f} times that of the positions, as if it were in {unit[0]}: "
                "check its unit"
            )
        if self._span:
            s.start, s.end = (f"{np.datetime64(t, 'us')}Z" for t in self._span)
        if self.edges is not None and self.edges.rows:
            s.matched = self.edges.matched / self.edges.rows
            s.off_map = dict(self.edges.reasons)
            if self.edges.kept:
                s.notes.append(f"the edges of {self.edges.kept:,} rows are those that the log has")

    def _clean(self, rows: Trajectory) -> Trajectory:
        """What a row tells by itself, and channels."""
        rows = clean.sort_rows(rows)
        rows = clean.drop_impossible(rows, self.rejects)
        rows = clean.bound_values(rows, self.rejects)
        rows = into_site(rows, self.site.map_frames, self.every)
        sample = rows
        rows = place(rows, self.site)
        if not self._checked and len(rows):
            check_place(rows.floats("x"), rows.floats("y"), self.site, sample)
            if looks_like_degrees(sample):
                self.summary.notes.append(
                    "x and y look like degrees: if they are, map them in a profile to longitude and latitude"
                )
            self._checked = True
        if CHANNEL in rows:
            before = len(rows)
            rows = join_channels(rows)
            self.summary.rows_joined += before - len(rows)
        return rows

    def _derive(self, rows: Trajectory) -> Trajectory:
        rows = clean.unstick(fill_positions(rows))
        full = derive_power(derive_motion(rows))
        for name in ("speed", "heading", "battery_power"):
            if full.has(name) and not rows.has(name):
                self._derived.add(name)
                own = self.summary.derived_by_vehicle.setdefault(rows.vehicle_id, [])
                if name not in own:
                    own.append(name)
        return full

    def _trip_ids(self, rows: Trajectory) -> Ints:
        own = rows.trip_ids()
        if rows.has("trip_id") and bool((own >= 0).all() and (np.diff(own) >= 0).all()):
            return own
        return trip_ids(rows, self._trip)

    def _write(self, rows: Trajectory) -> None:
        if not len(rows):
            return
        if self.edges is not None:
            rows = self.edges.match(rows)
        self._count(rows)
        rows = without(rows, *INTERNAL)
        self.writer.write(with_own_columns(rows, self.own))
        s = self.summary
        s.rows += len(rows)
        s.vehicles[rows.vehicle_id] = s.vehicles.get(rows.vehicle_id, 0) + len(rows)
        self._trips.update((rows.vehicle_id, int(t)) for t in np.unique(rows.trip_ids()))
        ends = [int(rows.time[0]), int(rows.time[-1])]
        self._span = [min([ends[0], *self._span[:1]]), max([ends[1], *self._span[1:]])]

    def _count(self, rows: Trajectory) -> None:
        """What the rows tell about the sensors."""
        self._stuck += int(np.nansum(rows.floats(STUCK))) if STUCK in rows else 0
        self._held += int(np.nansum(rows.floats(HELD))) if HELD in rows else 0
        if "speed" not in self._derived and len(self._paces) < 50 and (pace := pace_ratio(rows)) is not None:
            self._paces.append(pace)


def _cut(trips: Ints) -> int:
    """Rows to write now: up to the beginning of the last trip; within it only where it grows beyond
    memory.
    """
    begins = np.flatnonzero(np.diff(trips)) + 1
    if len(begins):
        return int(begins[-1])
    return max(len(trips) - OVERLAP, 0) if len(trips) > 2 * WINDOW_ROWS else 0
