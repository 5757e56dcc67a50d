"""The way of a recorded drive, laid along the roads that it was matched to, or along its own positions where it was not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.physics.power import Physics, allowed_speed
from fleetlog.roads.routing import Router
from fleetlog.simulate.drive import SpeedProfile, speed_profile
from fleetlog.simulate.state import creep_speed
from fleetlog.simulate.track import SPACING, Track
from fleetlog.simulate.way import Way, free_way, joined
from fleetlog.simulate.world import within

Floats = NDArray[np.float64]
Index = NDArray[np.int32]
MENDED = 40.0
"""A hole in a chain of edges is closed by a route of at most this length [m]; a longer one is a stop and a new leg."""
MATCHED = 0.8
"""A drive with fewer of its rows on a road follows its own positions."""
COARSE = 3.0
"""Own positions are taken this far apart: closer, noise would be turns [m]."""
FINE = 1.0
"""So far apart beside the road, where the ways are short [m]."""
OFF_LANE = 2.0
"""Farther than this from the middle of its road a truck is beside it [m]."""


class Pathfinder:
    """Ways on one site; ``track`` is its centred track (None without a network)."""

    def __init__(self, site: Site, track: Track | None, turn_radius: float) -> None:
        self.site, self.track, self.radius = site, track, turn_radius
        self.router = None if track is None else Router(track.network)
        self.known: dict[str, int] = {} if track is None else track.network.index

    def way(self, drive: Trajectory) -> Way | None:
        """The way of the rows of one drive; None where it goes nowhere."""
        x, y, z = drive.floats("x"), drive.floats("y"), np.nan_to_num(drive.floats("z"))
        if self.track is None:
            return self._own(x, y, z)
        edge = drive.labels("edge_id").recode(self.known)
        if not len(edge) or np.mean(edge >= 0) < MATCHED:
            return self._own(x, y, z)
        offset = np.nan_to_num(drive.floats("edge_offset"))
        a, b = on_lanes(edge, offset, np.nan_to_num(drive.floats("lateral_offset")))
        on = np.flatnonzero(edge[a:b] >= 0) + a
        road = self._on_roads(edge[on].astype(np.int32), offset[on])
        return None if road is None else self._with_ends(road, x, y, z, a, b)

    def _with_ends(self, road: Way, x: Floats, y: Floats, z: Floats, a: int, b: int) -> Way:
        """The road with the rows before ``a`` and from ``b`` on, where the truck came out of a bay and went into one."""
        first, last = ([road.x[k], road.y[k], road.z[k]] for k in (0, -1))
        for rows, after in ((slice(0, a), True), (slice(b, len(x)), False)):
            own = np.column_stack([x[rows], y[rows], z[rows]])
            own = own[np.isfinite(own).all(axis=1)]
            if not len(own):
                continue
            east, north, up = np.concatenate([own, [first]] if after else [[last], own]).T
            spur = free_way(east, north, up, FINE, self.radius)
            if spur is not None:
                pair = [spur, road] if after else [road, spur]
                # Out of a bay a truck backs: it stops before it drives on.
                turn = pair[1].heading[0] - pair[0].heading[-1]
                road = joined(pair, bool(np.cos(turn) < 0.0))
        return road

    def _on_roads(self, edge: Index, offset: Floats) -> Way | None:
        cut = np.flatnonzero(np.diff(edge) != 0)
        begin, end = np.concatenate([[0], cut + 1]), np.concatenate([cut, [len(edge) - 1]])
        legs: list[tuple[list[int], float, float]] = [
            ([int(edge[0])], float(offset[0]), float(offset[end[0]]))
        ]
        for b, e in zip(begin[1:], end[1:], strict=True):
            chain, start, _ = legs[-1]
            more = self._joined(chain[-1], int(edge[b]))
            if more is None:
                legs.append(([int(edge[b])], float(offset[b]), float(offset[e])))
            else:
                legs[-1] = (chain + more, start, float(offset[e]))
        ways = [w for w in (self._leg(*leg) for leg in legs) if w is not None]
        return joined(ways, True) if ways else None

    def _joined(self, a: int, b: int) -> list[int] | None:
        """Edges after ``a`` up to ``b``; None where only a long way leads there."""
        assert self.track is not None and self.router is not None
        if b in self.track.network.successors(a):
            return [b]
        route = self.router.route(a, b)
        if route is None:
            return None
        between = route.edges[1:-1]
        if float(self.track.network.length[between].sum()) > MENDED:
            return None
        return [int(e) for e in route.edges[1:]]

    def _leg(self, edges: list[int], start: float, end: float) -> Way | None:
        t = self.track
        assert t is not None
        pieces = t.pieces(np.array(edges))
        rows = np.concatenate([np.arange(t.first[p], t.first[p + 1]) for p in pieces])
        size = np.concatenate(
            [np.concatenate([[0.0], np.full(t.first[p + 1] - t.first[p] - 1, t.spacing[p])]) for p in pieces]
        )
        along = np.cumsum(size)
        first, last = (
            t.first[pieces[0] + 1] - t.first[pieces[0]],
            t.first[pieces[-1] + 1] - t.first[pieces[-1]],
        )
        low = float(np.interp(start, t.offset[rows[:first]], along[:first]))
        high = float(np.interp(end, t.offset[rows[-last:]], along[-last:]))
        if high - low < 0.5:
            return self._straight(edges[0], start, end) if len(edges) == 1 else None
        inner = np.flatnonzero(
            (along > low + 0.05) & (along < high - 0.05) & (np.append(np.diff(along), 1.0) > 0.0)
        )
        s = np.concatenate([[low], along[inner], [high]])
        near = np.clip(np.searchsorted(along, s, side="right") - 1, 0, len(rows) - 1)
        k = rows[near]

        def at(values: Floats) -> Floats:
            return np.asarray(np.interp(s, along, values[rows]), dtype=np.float64)

        offset = t.offset[k] + (s - along[near])
        way = Way(
            s - low, at(t.x), at(t.y), at(t.z), np.interp(s, along, np.unwrap(t.heading[rows])), at(t.curvature), t.slope[k],
            t.edge[k], offset,
        )  # fmt: skip
        # A lane ends before its junction, where the corner begins; a place may lie in between.
        ends = (
            self._straight(edges[0], start, float(t.offset[rows[0]])),
            self._straight(edges[-1], float(t.offset[rows[-1]]), end),
        )
        return joined([w for w in (ends[0], way, ends[1]) if w is not None], False)

    def _straight(self, edge: int, start: float, end: float) -> Way | None:
        """The edge itself from one offset to another; None where that is nothing."""
        assert self.track is not None
        if end - start < 0.3:
            return None
        n = max(2, int(np.ceil((end - start) / SPACING)) + 1)
        network, offset = self.track.network, np.linspace(start, end, n)
        one = np.full(n, edge, np.int32)
        place = network.position(one, offset)
        return Way(
            offset - start, place[:, 0], place[:, 1], place[:, 2], network.heading(one, offset), np.zeros(n),
            network.slope(one, offset), one, offset,
        )  # fmt: skip

    def _own(self, x: Floats, y: Floats, z: Floats) -> Way | None:
        good = np.isfinite(x) & np.isfinite(y)
        return free_way(x[good], y[good], z[good], COARSE, self.radius)


def on_lanes(edge: NDArray[np.integer], offset: Floats, lateral: Floats) -> tuple[int, int]:
    """Rows a to b of a drive between the bay that it came out of and the one that it went into; all of it without bays.

    Backing out goes on until the truck drives along its road.
    """
    beside = np.abs(lateral) > OFF_LANE
    if beside.all():
        return 0, len(edge)
    a, b = int(np.argmin(beside)), len(beside) - int(np.argmin(beside[::-1]))
    while 0 < a < b - 1 and edge[a + 1] == edge[a] and offset[a + 1] < offset[a]:
        a += 1
    return a, b


def drive_along(way: Way, site: Site, physics: Physics, payload: float) -> SpeedProfile:
    """How the truck drives a way from rest to rest with ``payload`` [kg]; terms that act on speed included."""
    truck = physics.actual_truck()
    limit = np.full(len(way.distance), np.inf)
    if site.network is not None:
        roads = np.where(np.isfinite(site.network.speed_limit), site.network.speed_limit, np.inf)
        limit = np.where(way.edge >= 0, roads[np.maximum(way.edge, 0)], np.inf)
        # Where two roads meet, the lower limit holds on both sides of the node.
        limit = np.minimum(limit, np.concatenate([limit[:1], limit[:-1]]))
    for zone in site.zones:
        if np.isfinite(zone.speed_limit):
            limit = np.where(within(zone.polygon, way.x, way.y), np.minimum(limit, zone.speed_limit), limit)
    allowed = np.minimum(limit * truck.drive.speed_factor, truck.drive.max_speed)
    if (way.edge >= 0).any():
        # Into a bay and out of it a truck creeps.
        allowed = np.where(way.edge < 0, np.minimum(allowed, creep_speed(truck)), allowed)
    motion = way.at(way.distance, payload).replaced(speed=allowed, curvature=way.curvature)
    cap = np.maximum(allowed_speed(motion, physics), 0.05)
    stops = dict.fromkeys(way.stops, 0.0)
    if "waiting" in physics.fields and "waiting" not in physics.off:
        stops.update(waits(physics.fields["waiting"].along(motion, 0.0)))
    return speed_profile(
        way.distance, np.nan, truck, slope=way.slope, payload=payload, stops=stops, extra=cap
    )


def waits(seconds: Floats) -> dict[int, float]:
    """Node in the middle of every stretch with a waiting time, and that time [s]."""
    on = np.concatenate([[False], seconds > 0.0, [False]])
    edges = np.flatnonzero(np.diff(on.astype(np.int8))).reshape(-1, 2)
    return {int((a + b - 1) // 2): float(seconds[(a + b - 1) // 2]) for a, b in edges}
