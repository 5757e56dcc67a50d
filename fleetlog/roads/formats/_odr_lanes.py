"""OpenDRIVE lanes as directed edges: which are driven, which way, along which line."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fleetlog.core.network import reverse_id
from fleetlog.roads.formats._odr_geometry import sample
from fleetlog.roads.formats._odr_parse import End, Lane, Road, Section, stations
from fleetlog.roads.formats.base import Floats, Tally

DRIVEN = frozenset({
    "driving", "bidirectional", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane",
    "mwyEntry", "mwyExit",
})  # fmt: skip
"""Lane types that are driven unless the user says otherwise."""
CHORD = 0.005
"""Largest distance [m] of a lane's centre line from its polyline."""
MICRO = 1e-3
"""A lane section shorter than this [m] is no edge; its links are carried through."""
THIN = 0.05
"""A lane that is nowhere wider than this [m] is not there."""

LaneKey = tuple[str, int, int]
"""Road, section, lane."""
LaneEnd = tuple[str, int, int, End]


@dataclass(frozen=True)
class LaneEdge:
    """One direction of one lane section; it leaves at the lane end ``leaves`` and enters at ``enters``."""

    id: str
    key: LaneKey
    enters: LaneEnd
    leaves: LaneEnd
    points: Floats
    speed_limit: float
    width: float


def lane_edges(
    road: Road, driven: frozenset[str], left: bool, tally: Tally, skipped: dict[str, float]
) -> Iterator[LaneEdge]:
    """The edges of a road; ``skipped`` gathers the lengths [m] of the lanes left out, by type."""
    for k, section in enumerate(road.sections):
        length = section.end - section.start
        for lane in section.lanes.values():
            if lane.id == 0:
                continue
            tally.read += 1
            if lane.type not in driven:
                tally.drop(f"lane type {lane.type}")
                skipped[lane.type] = skipped.get(lane.type, 0.0) + length
            elif length < MICRO:
                tally.drop("shorter than 1 mm")
            elif (widths := _widths(road, section, lane)).max() < THIN:
                tally.drop("without width")
            else:
                tally.kept += 1
                yield from _directed(road, k, lane, left, float(widths.mean()))


def _directed(road: Road, k: int, lane: Lane, left: bool, width: float) -> Iterator[LaneEdge]:
    section = road.sections[k]
    points = centre_line(road, section, lane)
    limit = speed_limit(road, section, lane)
    key: LaneKey = (road.id, k, lane.id)
    low: LaneEnd = (*key, "start")
    high: LaneEnd = (*key, "end")
    name = f"{road.id}:{k}:{lane.id}"
    for edge_id, forward in zip((name, reverse_id(name)), directions(lane, left), strict=False):
        ends, line = ((low, high), points) if forward else ((high, low), points[::-1].copy())
        yield LaneEdge(edge_id, key, *ends, line, limit, width)


def directions(lane: Lane, left: bool) -> tuple[bool, ...]:
    """Whether the lane is driven along s (True) or against it; two-way lanes both, the usual way first."""
    usual = (lane.id < 0) != left
    if lane.direction in ("+s", "-s"):
        return (lane.direction == "+s",)
    if lane.direction == "both" or lane.type == "bidirectional":
        return (usual, not usual)
    return (not usual,) if lane.direction == "reversed" else (usual,)


def centre_line(road: Road, section: Section, lane: Lane) -> Floats:
    """(n, 3) centre of a lane [m] along s; chords within 5 mm of it."""
    side = 1 if lane.id > 0 else -1
    inward = [section.lanes[i] for i in range(side, lane.id + side, side)]

    def at(s: Floats) -> Floats:
        # Records that start at the end of the section speak of the next one.
        s = np.minimum(s, section.end - 1e-7)
        x, y, heading = road.plan.at(s)
        t = np.mean(_sides(road, section, lane, s), axis=0)
        roll = road.superelevation.at(s)
        flat = t * np.cos(roll)
        z = road.elevation.at(s) + t * np.sin(roll)
        return np.column_stack([x - flat * np.sin(heading), y + flat * np.cos(heading), z])

    return at(sample(at, stations(road, section, inward), CHORD))


def _sides(road: Road, section: Section, lane: Lane, s: Floats) -> tuple[Floats, Floats]:
    """(N,) lateral places t [m] of the inner and outer border of a lane, left positive."""
    side = 1 if lane.id > 0 else -1
    inner = outer = offset = road.offset.at(s)
    for i in range(side, lane.id + side, side):
        inward = section.lanes[i]
        inner = outer
        if len(inward.widths.starts) or not len(inward.borders.starts):
            outer = inner + side * np.maximum(inward.widths.at(s), 0.0)
        else:
            outer = offset + inward.borders.at(s)
    return inner, outer


def _widths(road: Road, section: Section, lane: Lane) -> Floats:
    """Width [m] at nine places along a lane section."""
    inner, outer = _sides(road, section, lane, np.linspace(section.start, section.end - 1e-7, 9))
    return np.asarray(np.abs(outer - inner), dtype=np.float64)


def speed_limit(road: Road, section: Section, lane: Lane) -> float:
    """Limit [m/s] on the greatest part of the lane section, the lane's or else the road's; NaN unknown."""
    return _lasting(lane.speeds, section) if lane.speeds else _lasting(road.speeds, section)


def _lasting(records: tuple[tuple[float, float], ...], section: Section) -> float:
    best, longest = math.nan, 0.0
    rows = [*sorted(records, key=lambda r: r[0]), (math.inf, math.nan)]
    for (s, limit), (until, _) in pairwise(rows):
        part = min(until, section.end) - max(s, section.start)
        if part > longest + 1e-9:
            best, longest = limit, part
    return best
