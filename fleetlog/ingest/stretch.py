"""One vehicle, stretch by stretch: cleaned, placed, matched, cut into trips, written."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fleetlog.core.arrays import Ints
from fleetlog.core.network import Network
from fleetlog.core.site import MapFrame, Site
from fleetlog.core.trajectory import Labels, Trajectory, concatenate
from fleetlog.importers.base import GEOGRAPHIC
from fleetlog.ingest import clean, derive
from fleetlog.ingest.place import check_place, into_site, looks_like_degrees, place, with_frame
from fleetlog.ingest.rows import CHANNEL, HELD, STUCK, WINDOW_ROWS, Rejects, Slip, windows, with_own_columns
from fleetlog.ingest.summary import DERIVED, MOST_PACES, Outcome
from fleetlog.store.trips import STANDING_SPEED, trip_ids
from fleetlog.store.writer import NOTHING, DatasetWriter, Older

if TYPE_CHECKING:
    from fleetlog.roads.matching import MatchParameters

DEGREES = "x and y look like degrees: if they are, map them in a profile to longitude and latitude"
AT_SEA = {"latitude": np.pi / 2.0, "longitude": np.pi}  # Within these bounds [degrees] there is no land
RADIANS = "the positions are off the coast of Africa: if they are radians, state unit = 'rad' in a profile"
ESTIMATE_ROWS = 2000  # The parameters of matching are estimated on the first stretch that has this many rows
OVERLAP = 5000  # Rows kept back where a stretch has to end within a trip


@dataclass(frozen=True)
class Plan:
    """What is the same for all vehicles of an import. ``folder`` is that of the dataset being written,
    ``scratch`` takes files of the import's own; ``names`` are those of the logs, ``own`` their own columns;
    ``positioned``, ``driven`` the vehicles that have positions, and speeds."""

    folder: Path
    scratch: Path
    site: Site
    names: list[str]
    own: dict[str, bool] = field(default_factory=dict)
    positioned: frozenset[str] = frozenset()
    driven: frozenset[str] = frozenset()
    before: Older = NOTHING  # What the dataset holds that is added to
    every: MapFrame | None = None  # The frame of all rows
    parameters: "MatchParameters | None" = None
    notes: tuple[str, ...] = ()  # What the first rows look like


def import_vehicle(plan: Plan, job: tuple[int, str, list[Slip]]) -> Outcome:
    """Clean, place, match and write the rows of one vehicle."""
    number, vehicle, slips = job
    rejects = Rejects(plan.scratch / f"vehicle-{number}.parquet", plan.names)
    work = VehicleImport(plan, rejects, plan.before.next_trip.get(vehicle, 0))
    for rows, last in windows(slips):
        if vehicle in plan.positioned | plan.driven:
            work.take(rows, last=last)
        else:
            rejects.refuse(rows, np.ones(len(rows), bool), "no log has a position or a speed of this vehicle")
    rejects.close()
    return work.out


def probe(plan: Plan, slips: Mapping[str, Sequence[Slip]]) -> Plan:
    """The plan with the site's frame and the parameters of matching, from the first stretches of the logs.
    :class:`~fleetlog.errors.DataError` where the logs are of another place than the site."""
    vehicles = (windows(slips[vehicle]) for vehicle in sorted(plan.positioned))
    for number, (rows, _) in enumerate(chain.from_iterable(vehicles)):
        if number == 0:
            site, notes = with_frame(plan.site, rows), (DEGREES,) if looks_like_degrees(rows) else ()
            if "latitude" in rows and not any((np.abs(rows.floats(n)) > m).any() for n, m in AT_SEA.items()):
                notes = (RADIANS,)
            own = {n: t for n, t in plan.own.items() if site.frame is None or n not in GEOGRAPHIC}
            plan = replace(plan, site=site, own=own, notes=notes)
        rows = VehicleImport(plan, Rejects()).prepared(rows, check=number == 0)
        network = plan.site.network
        if network is None or has_edges(rows, network):
            break
        if len(rows) >= ESTIMATE_ROWS:
            from fleetlog.roads.matching import estimate_parameters

            return replace(plan, parameters=estimate_parameters(rows, network))
    return plan


def load_matcher(site: Site | None) -> None:
    """Bring the kernels of the matcher into memory, by a drive along a road."""
    if site is not None and site.network:
        from fleetlog.roads.matching import match

        x, y, _ = site.network.polyline(0).T
        match(Trajectory("", np.arange(len(x)) * 1_000_000, {"x": x, "y": y}), site.network)


class VehicleImport:
    """The second half of an import for one vehicle; its rows come in order of time."""

    def __init__(self, plan: Plan, rejects: Rejects, trip: int = 0) -> None:
        self.plan, self.rejects = plan, rejects
        self.writer = DatasetWriter(plan.folder, "recorded", plan.site, plan.before)
        self.out = Outcome(rejects, self.writer.pieces, self.writer.columns)
        self._kept_back: list[Trajectory] = []
        self._first_trip = self._trip = trip

    def prepared(self, rows: Trajectory, *, check: bool) -> Trajectory:
        """The first rows of the vehicle as they are matched; ``check`` that they are of the site's place."""
        rows = self._in_order(self._clean(rows, check=check))
        return self._derive(rows) if len(rows) else rows

    def take(self, rows: Trajectory, *, last: bool) -> None:
        """The next stretch of the vehicle, unsorted."""
        pieces, self._kept_back = [*self._kept_back, self._clean(rows)], []
        rows = self._in_order(concatenate([p for p in pieces if len(p)] or pieces))
        if not len(rows):
            return
        full = self._derive(rows)
        trips = full.trip_ids()  # the log's own, where they count up
        if not full.has("trip_id") or (trips < self._first_trip).any() or (np.diff(trips) < 0).any():
            trips = trip_ids(full, self._trip)
        cut = len(rows) if last else _cut(trips)
        for name in DERIVED:  # of a column without any value in the log ``derived`` tells
            if rows.has(name):
                lacking = np.isnan(rows.floats(name)) & ~(rows.floats(HELD) > 0.0)
                made = np.isfinite(full.floats(name)) & lacking
                self.out.filled[name] += int(made[:cut].sum())
        self._write(full[:cut].with_columns(trip_id=trips[:cut]))
        if not last:
            self._kept_back, self._trip = [rows[cut:]], int(trips[cut])

    def _clean(self, rows: Trajectory, *, check: bool = False) -> Trajectory:
        """What a row tells by itself, and channels."""
        site = self.plan.site
        rows = clean.drop_impossible(clean.sort_rows(rows), self.rejects)
        rows = clean.bound_values(rows, self.rejects)
        sample = into_site(rows, site.map_frames, self.plan.every)
        rows = place(sample, site)
        if "x_log" in rows and "x_log" not in sample:
            self.out.counts["other_frame"] += len(rows)
        if check and len(rows):
            check_place(rows, site, sample)
        # Of a vehicle without positions there is no row that values of other messages go onto.
        placed = rows.vehicle_id in self.plan.positioned
        joined = derive.join_channels(rows) if placed else rows.without(CHANNEL)
        self.out.counts["joined"] += len(rows) - len(joined)
        return joined

    def _in_order(self, rows: Trajectory) -> Trajectory:
        """What a row tells beside its neighbours."""
        rows = clean.drop_duplicates(clean.sort_rows(rows), self.rejects)
        return clean.drop_jumps(derive.release_held(rows), self.rejects)

    def _derive(self, rows: Trajectory) -> Trajectory:
        rows = clean.unstick(derive.fill_positions(rows))
        full = derive.derive_power(derive.derive_motion(rows))
        if made := [n for n in DERIVED if full.has(n) and not rows.has(n)]:
            known = self.out.derived.setdefault(rows.vehicle_id, [])
            known += [n for n in made if n not in known]
        return full

    def _write(self, rows: Trajectory) -> None:
        if not len(rows):
            return
        if self.plan.site.network is not None and rows.vehicle_id in self.plan.positioned:
            rows = self._match(rows, self.plan.site.network)
        self.writer.write(with_own_columns(rows, self.plan.own))
        speed, powers = rows.floats("speed"), self.out.driven_power
        power = rows.floats("battery_power")[speed > STANDING_SPEED]
        stuck, held = (int(np.nansum(rows.floats(name))) for name in (STUCK, HELD))
        self.out.counts.update(stuck=stuck, held=held, driven=int(np.isfinite(power).sum()))
        self.out.counts["fast"] += int((speed >= clean.MAX_SPEED).sum())
        powers[rows.vehicle_id] = powers.get(rows.vehicle_id, 0.0) + float(np.nansum(power))
        derived = self.out.derived.get(rows.vehicle_id, ())
        if "heading" not in derived and (reading := derive.other_reading(rows)):
            self.out.readings.setdefault(rows.vehicle_id, reading)
        asked = "speed" not in derived and len(self.out.paces) < MOST_PACES
        if asked and (pace := derive.pace_ratio(rows)) is not None:
            self.out.paces.append(pace)

    def _match(self, rows: Trajectory, network: Network) -> Trajectory:
        """The rows on the roads, and how many are and why others are not."""
        counts = self.out.counts
        if has_edges(rows, network):
            counts["kept"] += len(rows)
        else:
            from fleetlog.roads import matching

            found = matching.match(rows, network, self.plan.parameters)
            reason = np.where(found.edge < 0, found.reason.astype(np.int32), -1)
            rows = rows.with_columns(
                edge_id=Labels(found.edge, network.edge_ids), edge_offset=found.offset,
                lateral_offset=found.lateral, match_confidence=found.confidence,
                match_reason=Labels(reason, matching.REASONS),
            )  # fmt: skip
        codes, why = rows.labels("edge_id").codes, rows.labels("match_reason")
        counts["matched"] += len(rows)
        counts["on_road"] += int((codes >= 0).sum())
        for code, number in zip(*np.unique(why.codes[codes < 0], return_counts=True), strict=True):
            if code >= 0:
                self.out.off_map[why.names[code]] += int(number)
        return rows


def has_edges(rows: Trajectory, network: Network) -> bool:
    """Whether the rows are of a dataset that comes back: their edges are those of this map."""
    labels = rows.labels("edge_id")
    used = {labels.names[code] for code in np.unique(labels.codes[labels.codes >= 0]).tolist()}
    return rows.has("edge_id") and rows.has("edge_offset") and used <= network.index.keys()


def _cut(trips: Ints) -> int:
    """Rows to write now: up to the last trip's beginning, or within it beyond memory."""
    if len(begins := np.flatnonzero(np.diff(trips)) + 1):
        return int(begins[-1])
    return max(len(trips) - OVERLAP, 0) if len(trips) > 2 * WINDOW_ROWS else 0
