"""The ways that trucks drive on, sampled: a lane for every directed edge, a connector for every turn."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.network import Network
from fleetlog.core.truck import Truck

BOW = 0.1  # A gentle kink is rounded as widely as the curve can while this close to the corner [m]
FINE = 0.1  # Length of the chords that stand for a curve [m]
SPACING = 0.5  # Between samples, at most [m]
DEFAULT_WIDTH = 4.0  # Of a two-way road whose width the map does not give [m]
CLEARANCE = 0.5  # Two trucks pass on a road that is this much wider than each of them [m]
SWING = 1.8  # After a turn by more than this a truck may be beside the lane that it came from [rad]
WIDEST_SHIFT = 1.5  # A lane is never farther than this from the centre line [m]


def shifted(points: Floats, left: float) -> Floats:
    """The polyline (n, 2) or (n, 3) moved ``left`` metres to its left, corners mitred; heights stay."""
    if left == 0.0:
        return points
    step = np.diff(points[:, :2], axis=0)
    step = step / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
    normal = np.column_stack([-step[:, 1], step[:, 0]])
    at = np.concatenate([normal[:1], normal[:-1] + normal[1:], normal[-1:]])
    size = np.linalg.norm(at, axis=1)
    at = at / np.maximum(size, 1e-9)[:, None]
    mitre = np.concatenate([[1.0], 2.0 / np.maximum(size[1:-1], 1.0), [1.0]])
    return np.column_stack([points[:, :2] + left * mitre[:, None] * at, points[:, 2:]])


def simplified(points: Floats) -> Floats:
    """Without vertices that repeat the one before."""
    dx, dy = np.diff(points, axis=0).T
    kept = points[np.append(True, np.hypot(dx, dy) > 1e-6)]
    return kept if len(kept) >= 2 else points[[0, -1]]


def rounded(points: Floats, radius: float) -> Floats:
    """The (n, 2) polyline, corners rounded with ``radius`` or more as far as the legs are long enough."""
    if len(points := simplified(points)) < 3:
        return points
    out = [points[:1]]
    leg = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for i in range(1, len(points) - 1):
        a, b = (points[i] - points[i - 1]) / leg[i - 1], (points[i + 1] - points[i]) / leg[i]
        turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)
        if abs(turn) < 1e-4 or abs(turn) > 3.0:
            out.append(points[i : i + 1])
            continue
        reach = max(radius * np.tan(abs(turn) / 2.0), BOW / np.tan(abs(turn) / 4.0))
        out.append(arc(points[i], a, turn, min(reach, 0.499 * leg[i - 1], 0.499 * leg[i])))
    return np.concatenate([*out, points[-1:]])


def arc(corner: Floats, into: Floats, turn: float, reach: float) -> Floats:
    """An arc that turns by ``turn`` [rad] from ``reach`` [m] before ``corner`` on, heading ``into``."""
    radius = reach / np.tan(abs(turn) / 2.0)
    begin = corner - reach * into
    centre = begin + radius * (np.array([-into[1], into[0]]) * np.sign(turn))
    angle = np.linspace(0.0, turn, max(2, int(np.ceil(radius * abs(turn) / FINE))) + 1)
    spoke = begin - centre
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([centre[0] + c * spoke[0] - s * spoke[1], centre[1] + s * spoke[0] + c * spoke[1]])


def joined(start: Floats, out: float, end: Floats, into: float) -> Floats:
    """Straight, arc, straight from ``start`` heading ``out`` to ``end`` heading ``into``, else a cubic."""
    a, b = np.array([np.cos(out), np.sin(out)]), np.array([np.cos(into), np.sin(into)])
    gap = end - start
    cross = a[0] * b[1] - a[1] * b[0]
    turn = float(np.arctan2(cross, a @ b))
    if abs(turn) < 1e-3 and abs(a[0] * gap[1] - a[1] * gap[0]) < 1e-3 * max(np.hypot(*gap), 1e-9):
        return np.array([start, end])
    if abs(cross) > 1e-6:
        first = (gap[0] * b[1] - gap[1] * b[0]) / cross
        last = (a[0] * gap[1] - a[1] * gap[0]) / cross
        if first > 1e-3 and last > 1e-3 and abs(turn) < 2.6:
            return np.concatenate([[start], arc(start + first * a, a, turn, min(first, last)), [end]])
    # A cubic whose handles point along the headings.
    handle = max(0.65 * float(np.hypot(*gap)), 0.5)
    u, p1, p2 = np.linspace(0.0, 1.0, 41)[:, None], start + handle * a, end - handle * b
    return np.asarray((1 - u) ** 3 * start + 3 * u * (1 - u) ** 2 * p1 + 3 * u**2 * (1 - u) * p2 + u**3 * end)


def even(points: Floats, spacing: float) -> tuple[Floats, float]:
    """(n, 4) x, y, heading, curvature evenly, at most ``spacing`` [m] apart, along a polyline; its length."""
    x, y = simplified(points).T
    dx, dy = np.diff(x), np.diff(y)
    along = np.concatenate([[0.0], np.cumsum(np.sqrt(dx * dx + dy * dy))])
    chord = np.arctan2(dy, dx)
    chord[1:] -= 2.0 * np.pi * np.cumsum(np.round(np.diff(chord) / (2.0 * np.pi)))
    length = max(float(along[-1]), 1e-3)
    n = max(2, int(np.ceil(length / spacing)) + 1)
    s = np.arange(n) * (length / (n - 1))
    # A chord's direction is that of the curve at its middle.
    heading = np.interp(s, 0.5 * (along[:-1] + along[1:]), chord)
    curvature = np.gradient(heading, length / (n - 1))
    return np.column_stack([np.interp(s, along, x), np.interp(s, along, y), heading, curvature]), length


@lru_cache(maxsize=4096)
def bow(ahead: float, left: float, turn: float, spacing: float) -> tuple[Floats, float]:
    """The way from the origin along x to ``ahead``, ``left`` [m], turned by ``turn`` [rad]; see ``even``."""
    return even(joined(np.zeros(2), 0.0, np.array([ahead, left]), turn), spacing)


def moved(shape: Floats, x: float, y: float, heading: float) -> Floats:
    """(n, 4) x, y, heading, curvature of a curve that begins at the origin along x, begun elsewhere."""
    c, s = np.cos(heading), np.sin(heading)
    along, left, turn, curvature = shape.T
    return np.column_stack([x + c * along - s * left, y + s * along + c * left, turn + heading, curvature])


@dataclass(frozen=True)
class Track:
    """P pieces: lanes 0..E-1 (of edge i), then one connector for each entry of the network's ``next_edges``.

    first : (P + 1,) piece p owns samples first[p]:first[p + 1];  spacing, length : (P,) [m].
    source, target : (P,) lanes that a connector joins, -1 for lanes.
    x, y, z, heading, curvature, slope : (S,) of the path;  edge, offset, lateral : (S,) it on the map."""

    network: Network
    first: Ints
    spacing: Floats
    length: Floats
    source: Index
    target: Index
    x: Floats
    y: Floats
    z: Floats
    heading: Floats
    curvature: Floats
    slope: Floats
    edge: Index
    offset: Floats
    lateral: Floats

    def __len__(self) -> int:
        return len(self.length)

    @cached_property
    def owner(self) -> Index:
        """(S,) piece of every sample."""
        return np.repeat(np.arange(len(self), dtype=np.int32), np.diff(self.first))

    @cached_property
    def samples(self) -> Floats:
        """(S, 8) x, y, z, heading, curvature, slope, offset, lateral."""
        return np.column_stack([
            self.x, self.y, self.z, self.heading, self.curvature, self.slope, self.offset, self.lateral,
        ])  # fmt: skip

    @cached_property
    def swings(self) -> Mask:
        """(P,) connectors that turn by more than ``SWING``: their two lanes lie side by side."""
        turn = self.heading[self.first[1:] - 1] - self.heading[self.first[:-1]]
        return np.asarray((np.abs(np.angle(np.exp(1j * turn))) > SWING) & (self.source >= 0))

    @cached_property
    def by_turn(self) -> dict[tuple[int, int], int]:
        """The connector from one edge to another."""
        turns = zip(self.source.tolist(), self.target.tolist(), strict=True)
        return {turn: p for p, turn in enumerate(turns) if turn[0] >= 0}


def lane_shift(network: Network, truck: Truck, traffic: str) -> Floats:
    """(E,) metres that lanes lie left (+) or right (-) of their edges; 0 on one-way and single-lane roads."""
    width = np.where(np.isfinite(network.width), network.width, DEFAULT_WIDTH)
    two_lanes = (network.reverse >= 0) & (width >= 2.0 * (truck.chassis.width + CLEARANCE))
    shift = np.where(two_lanes, np.minimum(width / 4.0, WIDEST_SHIFT), 0.0)
    return np.asarray(shift if traffic == "left" else -shift)


def build_track(network: Network, truck: Truck, traffic: str = "right") -> Track:
    """Lanes, cut before junctions for the turns, and connectors that turn with the turn radius."""
    shift = lane_shift(network, truck, traffic)
    radius = truck.chassis.turn_radius
    before, after = _trims(network, radius, np.abs(shift))
    shapes = []
    for e in range(len(network)):
        points = simplified(stretch(network.polyline(e)[:, :2], before[e], -after[e]))
        shapes.append(even(rounded(shifted(points, shift[e]), radius), SPACING))
    owner = np.repeat(np.arange(len(network)), np.diff(network.next_first)).astype(np.int32)
    for a, b in zip(owner, network.next_edges, strict=True):
        (x, y, heading, _), end = shapes[a][0][-1], shapes[b][0][0]
        to = complex(end[0] - x, end[1] - y) * np.exp(-1j * heading)
        turn = np.angle(np.exp(1j * (end[2] - heading)))
        # Most junctions of a plant are alike, to a micrometre.
        shape, length = bow(*np.round([to.real, to.imag, turn], 6).tolist(), SPACING)
        shapes.append((moved(shape, x, y, heading), length))
    none = np.full(len(network), -1, np.int32)
    source, target = np.concatenate([none, owner]), np.concatenate([none, network.next_edges])
    return assemble(network, shapes, source, target, np.arange(len(shapes), dtype=np.int32))


def assemble(
    network: Network, shapes: list[tuple[Floats, float]], source: Index, target: Index, lanes: Index
) -> Track:
    """The track of given shapes, each sample laid on its lane, of connectors on the nearer one."""
    from fleetlog.simulate.kernels.geometry import project_points

    count = np.array([len(s) for s, _ in shapes])
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    length = np.array([size for _, size in shapes])
    x, y, heading, curvature = np.ascontiguousarray(np.concatenate([s for s, _ in shapes]).T)
    piece = np.repeat(np.arange(len(count)), count)
    late = np.arange(len(x)) - first[piece] >= count[piece] / 2
    edge = np.where(source[piece] < 0, lanes[piece], np.where(late, target[piece], source[piece]))
    plane = np.ascontiguousarray(network.points[:, :2])
    offset, lateral = np.zeros((2, len(x)))
    project_points(plane, network.first, network.distance, edge, x, y, offset, lateral)
    return Track(
        network, first, length / (count - 1), length, source.astype(np.int32), target.astype(np.int32), x, y,
        network.position(edge, offset)[:, 2].copy(), np.angle(np.exp(1j * heading)), curvature,
        network.slope(edge, offset), edge, offset, lateral,
    )  # fmt: skip


def _trims(network: Network, radius: float, shift: Floats) -> tuple[Floats, Floats]:
    """(E,) metres cut from the start and from the end of every lane to make room for the turns."""
    every = np.arange(len(network), dtype=np.int32)
    leave, enter = network.heading(every, network.length), network.heading(every, np.zeros(len(network)))
    owner = np.repeat(every, np.diff(network.next_first))
    turn = np.abs(np.angle(np.exp(1j * (enter[network.next_edges] - leave[owner]))))
    wide = radius + np.maximum(shift[owner], shift[network.next_edges])
    need = wide * np.tan(np.minimum(turn, 1.9) / 2.0)
    # Turning round at a dead end is done beyond the last metre.
    need = np.where(turn > 2.8, 1.0, need) + 0.05
    before, after = np.full(len(network), 0.05), np.full(len(network), 0.05)
    np.maximum.at(after, owner, need)
    np.maximum.at(before, network.next_edges, need)
    share = np.minimum(1.0, 0.9 * network.length / (before + after))
    return before * share, after * share


def stretch(points: Floats, start: float, end: float) -> Floats:
    """The part of a polyline (n, k) between two distances [m] along it; a negative ``end`` from its end."""
    run = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    start, end = max(start, 0.0), end if end >= 0.0 else end + run[-1]
    end = min(max(end, start + 1e-3), float(run[-1]))
    start = min(start, end - 1e-3)
    at = np.concatenate([[start], run[(run > start) & (run < end)], [end]])
    return np.column_stack([np.interp(at, run, c) for c in points.T])
