"""OpenDRIVE lanes as directed edges: which are driven, which way, along which line."""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fleetlog.core.network import Edge, Floats, reverse_id
from fleetlog.roads.formats._odr_geometry import sample
from fleetlog.roads.formats._odr_parse import ENDS, End, Lane, Road, Section
from fleetlog.roads.formats.base import Tally

DRIVEN = frozenset({
    "driving", "bidirectional", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane",
    "mwyEntry", "mwyExit",
})  # fmt: skip
"""Lane types that are driven unless the user says otherwise."""
CHORD = 0.005  # largest distance [m] of a lane's centre line from its polyline
MICRO = 1e-3  # a lane section shorter than this [m] is no edge; its links are carried through
THIN = 0.05  # a lane that is nowhere wider than this [m] is not there
BEFORE_END = 1e-7
"""Records that start at the end of a section speak of the next one: it is read this far before it [m]."""


class LaneEnd(NamedTuple):
    """One end of a lane of a section."""

    road: str
    section: int
    lane: int
    end: End

    def __str__(self) -> str:
        return f"{self.road}:{self.section}:{self.lane}:{self.end}"


def lane_edges(
    road: Road, driven: frozenset[str], left: bool, tally: Tally, skipped: dict[str, float]
) -> Iterator[Edge]:
    """The edges of a road, from lane end to lane end; ``skipped`` gathers the metres left out, by type."""
    for k, section in enumerate(road.sections):
        length = section.end - section.start
        some = np.linspace(section.start, section.end - BEFORE_END, 9)
        for lane in section.lanes.values():
            if lane.id == 0:
                continue
            widths = np.abs(np.diff(_sides(road, section, lane, some), axis=0))
            if lane.type not in driven:
                tally.dropped[f"lane type {lane.type}"] += 1
                skipped[lane.type] += length
            elif length < MICRO:
                tally.dropped["shorter than 1 mm"] += 1
            elif widths.max() < THIN:
                tally.dropped["without width"] += 1
            else:
                tally.kept += 1
                yield from _directed(road, k, lane, left, float(widths.mean()))


def _directed(road: Road, k: int, lane: Lane, left: bool, width: float) -> Iterator[Edge]:
    section = road.sections[k]
    points, name = _centre_line(road, section, lane), f"{road.id}:{k}:{lane.id}"
    # The limit on the greatest part of the section, the lane's or else the road's.
    limit = _lasting(lane.speeds or road.speeds, section)
    low, high = (str(LaneEnd(road.id, k, lane.id, end)) for end in ENDS)
    for edge_id, forward in zip((name, reverse_id(name)), _directions(lane, left), strict=False):
        start, end, line = (low, high, points) if forward else (high, low, points[::-1].copy())
        yield Edge(edge_id, start, end, line, name, limit, width)


def _directions(lane: Lane, left: bool) -> tuple[bool, ...]:
    """Whether the lane is driven along s (True) or against it; two-way lanes both, the usual way first."""
    usual = (lane.id < 0) != left
    if lane.direction in ("+s", "-s"):
        return (lane.direction == "+s",)
    if lane.direction == "both" or lane.type == "bidirectional":
        return (usual, not usual)
    return (not usual,) if lane.direction == "reversed" else (usual,)


def _inward(section: Section, lane: Lane) -> list[Lane]:
    """The lanes from the centre to this one, itself included."""
    side = 1 if lane.id > 0 else -1
    return [section.lanes[i] for i in range(side, lane.id + side, side)]


def _centre_line(road: Road, section: Section, lane: Lane) -> Floats:
    """(n, 3) centre of a lane [m] along s; chords within 5 mm of it."""

    def at(s: Floats) -> Floats:
        s = np.minimum(s, section.end - BEFORE_END)
        x, y, heading = road.plan.at(s)
        t = np.mean(_sides(road, section, lane, s), axis=0)
        roll = road.superelevation.at(s)
        flat = t * np.cos(roll)
        z = road.elevation.at(s) + t * np.sin(roll)
        return np.column_stack([x - flat * np.sin(heading), y + flat * np.cos(heading), z])

    return at(sample(at, _stations(road, section, _inward(section, lane)), CHORD))


def _stations(road: Road, section: Section, lanes: list[Lane]) -> Floats:
    """s [m] of a section's ends, of every record that starts inside it, and at most 25 m apart."""
    cubics = [road.elevation, road.superelevation, road.offset]
    cubics += [table for lane in lanes for table in (lane.widths, lane.borders)]
    marks = np.concatenate([road.plan.starts, *(table.starts for table in cubics)])
    inner = marks[(marks > section.start + 1e-6) & (marks < section.end - 1e-6)]
    pieces = max(1, math.ceil((section.end - section.start) / 25.0))
    s = np.unique([*inner, *np.linspace(section.start, section.end, 1 + pieces)])
    # the last one is the end of the section, and stays
    return np.asarray(s[np.append(np.diff(s[:-1], prepend=-np.inf) > 1e-6, True)])


def _sides(road: Road, section: Section, lane: Lane, s: Floats) -> tuple[Floats, Floats]:
    """(N,) lateral places t [m] of the inner and outer border of a lane, left positive."""
    inner = outer = offset = road.offset.at(s)
    for inward in _inward(section, lane):
        inner = outer
        if len(inward.widths.starts) or not len(inward.borders.starts):
            outer = inner + np.sign(lane.id) * np.maximum(inward.widths.at(s), 0.0)
        else:
            outer = offset + inward.borders.at(s)
    return inner, outer


def _lasting(records: tuple[tuple[float, float], ...], section: Section) -> float:
    """Of (s, limit) the limit on the greatest part of a section [m/s]; NaN unknown."""
    best, longest = math.nan, 0.0
    for (s, limit), (until, _) in pairwise([*sorted(records), (math.inf, math.nan)]):
        part = min(until, section.end) - max(s, section.start)
        if part > longest + 1e-9:
            best, longest = limit, part
    return best
