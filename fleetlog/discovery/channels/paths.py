"""The paths of a fleet as the speed channel sees them: nodes in windows, who was in the way, time taken; and
what other trucks cost: time on stretches where one was in the way, over what they take otherwise."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from fleetlog.core.arrays import Floats, Ints, Mask
from fleetlog.core.motion import Motion, join
from fleetlog.core.network import Network
from fleetlog.discovery.hypotheses.cells import Stretches
from fleetlog.discovery.recording.blocks import TRIP, Windows, counted_on, narrow, picked, stacked
from fleetlog.discovery.recording.conflicts import Route, hindered, on_road
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import HELD_OUT, Split
from fleetlog.discovery.recording.turns import CENTRE, Seen
from fleetlog.physics.motion import legs
from fleetlog.physics.motion.legs import Leg

KINK, CORNER = 1.0, 0.5  # Way on which trucks on the map's line take a kink [m]; larger are no kinks [rad]
SHORTEST = 8.0  # A shorter leg says nothing of how fast one drives [m]
FEWEST = 5  # Turns on the spot that tell how long one takes
OWN = 60.0  # Undisturbed driving after which a stretch of lane is known by itself, not by all others [s]
MODEL = 0.01  # Share of the time by which the free drive may be off on all stretches alike


@dataclass(frozen=True)
class Path:
    """Legs of a vehicle-day laid end to end: G nodes.

    ``motion`` (G,) with ``speed`` that road and truck allow; ``s`` (G,) [m]; ``inside`` (G,) whether the
    node has a predecessor in its leg; ``of`` (G,) window; ``share`` (G,), of a unit, part of the passage of
    its place that belongs to a step; ``took`` (G,) seconds from the node before; what of it was spent
    ``standing`` at the node, neither for a purpose nor for another truck, and whether it stood for one there,
    ``held``; ``kink`` (G,) curvature [1/m] that a truck would
    take which follows the line of the map; ``across`` (G,) the limit [m/s] if that of junctions were the mean
    of their roads'; ``behind`` (W,) whether another truck was in the way in a window,
    and ``apart`` (W,) whether it was, but not what the truck stood for: in units only standing counts."""

    motion: Motion
    s: Floats
    inside: Mask
    of: Ints
    share: NDArray[np.float32]
    took: Floats
    standing: Floats
    held: Mask
    kink: NDArray[np.float32]
    across: NDArray[np.float32]
    behind: Mask
    apart: Mask

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.behind)

    def passages(self, place: Ints, size: Floats) -> tuple[Ints, Mask, NDArray[np.float32]]:
        """Return (G,) the passage of a ``place``, (G,), that each node belongs to; of each whether it is one;
        and (G,) what part of it a step is. Less than half of the ``size`` of a place, (C,) [m], is none.

        Of a passage with a stop on the way all belongs to the window that ends in the stop, whose time has
        the wait.  Whoever sets off there goes on with the passage that ended there."""
        first = np.diff(place, prepend=-1) != 0
        of, stood = np.cumsum(first) - 1, np.flatnonzero(self.standing > 0.0)
        step = np.where(self.inside, np.diff(self.s, prepend=self.s[:1]), 0.0)
        driven = np.bincount(of, step)
        passed = driven >= 0.5 * size[place[first]]
        share = np.where(passed[of], step / np.maximum(driven, 1e-9)[of], 0.0)
        share[np.isin(of, of[stood])] = 0.0
        share[stood[np.diff(of[stood], append=-1) != 0]] = 1.0
        passed[of[stood]] = True
        return of, passed, share.astype(np.float32)

    def alone(self, place: Ints) -> Mask:
        """Return (W,) windows without a passage of a place in which the truck also stood for another: nobody
        knows what of it was a wait."""
        of = np.cumsum(np.diff(place, prepend=-1) != 0)
        return np.asarray(self.summed(np.isin(of, of[self.held]).astype(float)) == 0.0)

    @property
    def last(self) -> Mask:
        """(G,) whether the node is the last of its leg."""
        return np.append(~self.inside[1:], True)

    def summed(self, values: Floats) -> Floats:
        """Return the sums of values at nodes over windows, (W,)."""
        return np.asarray(np.bincount(self.of, values, self.count), dtype=np.float64)

    def part(self, keep: Mask) -> tuple[Mask, "Path"]:
        """Return the legs that touch some windows, (W,): all the windows that they touch, and their path."""
        begin = np.flatnonzero(~self.inside)
        nodes = np.logical_or.reduceat(keep[self.of], begin)[np.cumsum(~self.inside) - 1]
        mine = np.bincount(self.of[nodes], minlength=self.count) > 0
        of = (np.cumsum(mine) - 1)[self.of[nodes]]
        one, other = self.behind[mine], self.apart[mine]
        return mine, Path(**picked(self, nodes, "of", "behind", "apart"), of=of, behind=one, apart=other)

    @staticmethod
    def joined(paths: list["Path"]) -> "Path":
        """Return paths of one vehicle, one after the other."""
        s = counted_on([p.s for p in paths], [p.s[-1] + 1.0 for p in paths])
        of = counted_on([p.of for p in paths], [p.count for p in paths])
        return Path(join([p.motion for p in paths]), s, of=of, **stacked(paths, "motion", "s", "of"))


Laid = tuple[Path, Windows, Floats, Mask]
"""The path of a day, its windows, what they took (W,) [s], and which of them count (W,)."""


@dataclass(frozen=True)
class Drive:
    """A leg, and (N,) of its nodes whether another truck was in the way, and whether it was off its road."""

    leg: Leg
    behind: Mask
    astray: Mask
    wait: float  # Seconds of the standstill after it that served no purpose


def laid_out(
    group: list[Route], fleet: Fleet, split: Split, lanes: Stretches, length: float, share: float
) -> Iterator[tuple[Laid | None, Iterator[Seen]]]:
    """Lay out what every vehicle drove on a date; and, of a share of the trips, what nobody was in the way
    of, which shows how turns are driven."""
    placed = [[on_road(leg) for leg in r.legs] for r in group]
    group = [replace(r, legs=tuple(leg for leg, _ in p)) for r, p in zip(group, placed, strict=True)]
    flags = hindered(group, [free_speed(r.nodes("edge"), fleet) for r in group], fleet.truck)
    paces = np.concatenate([(r.wait / r.turned.clip(1e-9))[r.turned > 0.0] for r in group])
    pace = float(np.median(paces)) if len(paces) >= FEWEST else 0.0
    for r, f, p in zip(group, flags, placed, strict=True):
        driven = list(_drives(r, *f, np.concatenate([a for _, a in p]), pace))
        yield _lay_out(r, driven, fleet, lanes, length), _undisturbed(r, driven, fleet, split, share)


def free_speed(edge: NDArray[Any], fleet: Fleet) -> Floats:
    """(N,) what road and truck allow on edges [m/s]."""
    assert fleet.network is not None
    drive = fleet.truck.drive
    limit = np.nan_to_num(fleet.network.speed_limit, nan=np.inf)[np.maximum(edge.astype(np.int64), 0)]
    return np.minimum(limit * drive.speed_factor, drive.max_speed)


def _drives(r: Route, behind: Mask, held: Mask, astray: Mask, pace: float) -> Iterator[Drive]:
    """Legs of a route, those joined between which it only stood since another truck was in the way. Turning
    on the spot takes ``pace`` [s/rad]: who stands for less than twice as long only turns."""
    last, turning = np.cumsum(r.size) - 1, pace * r.turned
    idle = (np.diff(r.errand, append=-1) == 0) & r.known & (r.wait > 2.0 * turning)
    # Where nothing tells what a stop was for, none is told to be for another truck.
    on = held[last] & behind[last] & idle
    first = 0
    for k in range(len(r.legs)):
        if on[k]:
            continue
        nodes = slice(int(last[first] - r.size[first] + 1), int(last[k]) + 1)
        wait = float(r.wait[k] - turning[k]) if idle[k] else 0.0
        yield Drive(legs.joined(list(r.legs[first : k + 1])), behind[nodes], astray[nodes], wait)
        first = k + 1


def _undisturbed(r: Route, drives: list[Drive], fleet: Fleet, split: Split, share: float) -> Iterator[Seen]:
    """The nodes that the search may look at, of a share of the trips."""
    path = join([v.leg.path for v in drives])
    use = split.rows(path.trip + TRIP * r.vehicle, path.time + r.start, r.vehicle, r.day, share) != HELD_OUT
    use &= ~np.concatenate([v.behind | v.astray for v in drives])
    ends = np.cumsum([len(v.behind) for v in drives])[:-1]
    parts = (np.split(values, ends) for values in (free_speed(path.edge, fleet), use))
    yield from zip([v.leg for v in drives], *parts, strict=True)


def _lay_out(r: Route, drives: list[Drive], fleet: Fleet, lanes: Stretches, length: float) -> Laid | None:
    """Lay out the legs of a day whose ends are known."""
    long = [v.leg.whole and v.leg.distance[-1] >= SHORTEST for v in drives]
    known = np.array([on and bool((v.leg.path.edge >= 0).all()) for on, v in zip(long, drives, strict=True)])
    if not (found := list(compress(drives, known))):
        return None
    parts = [v.leg for v in found]
    starts, motion = np.cumsum([0, *(len(leg.distance) for leg in parts)]), join([leg.path for leg in parts])
    inside = np.ones(len(motion), bool)
    inside[starts[:-1]] = False
    s = counted_on([leg.distance for leg in parts], [leg.distance[-1] + 1.0 for leg in parts])
    of = _windows(parts, length)
    count = int(of[-1]) + 1
    took = np.where(inside, np.diff(motion.time, prepend=motion.time[:1]), 0.0)
    standing = np.zeros(len(took))
    standing[starts[1:] - 1] = [v.wait for v in found]
    took += standing
    recorded = np.asarray(np.bincount(of, took, count), dtype=np.float64)
    assert fleet.network is not None
    limit = np.nan_to_num(fleet.network.speed_limit, nan=np.inf)[motion.edge]
    motion = motion.replaced(speed=limit, time=motion.time + r.start, vehicle=np.full(len(motion), r.vehicle))
    held = np.zeros(len(took), bool)
    held[[b + node for leg, b in zip(parts, starts, strict=False) for node in leg.stops]] = True
    held[starts[:-1][~np.append(False, known)[:-1][known]]] = True  # Nobody knows how long it stood before
    flags = (np.concatenate([getattr(v, name) for v in found]) for name in ("behind", "astray"))
    behind, astray = (np.bincount(of, flag, count) > 0 for flag in flags)
    metres = np.bincount(of, np.where(inside, np.diff(s, prepend=s[:1]), 0.0), count).astype(np.float64)
    middle = np.searchsorted(of, np.arange(count)) + np.bincount(of) // 2
    windows = Windows(
        trip=motion.trip[middle] + TRIP * r.vehicle, vehicle=motion.vehicle[middle],
        day=np.full(count, r.day),
        edge=motion.edge[middle].astype(np.int64), duration=np.maximum(metres, 0.5), distance=metres,
        x=motion.x[middle], y=motion.y[middle], time=motion.time[middle],
    )  # fmt: skip
    of, standing = of.astype(np.int32), standing.astype(np.float32)
    kink = kinks(fleet.network, motion.edge, motion.edge_offset).astype(np.float32)
    shared = across(limit, motion.edge, s, inside).astype(np.float32)
    apart = behind & ~astray & (recorded > 0.0)
    share = np.broadcast_to(np.float32(0.0), of.shape)
    path = Path(narrow(motion), s, inside, of, share, took, standing, held, kink, shared, behind, apart)
    return path, windows, recorded, (recorded > 0.0) & ~behind & ~astray


def kinks(network: Network, edge: NDArray[Any], offset: Floats) -> Floats:
    """(N,) curvature at places on edges [1/m] near a slight turn of the map's line, taken within ``KINK``."""
    turn = np.where(np.abs(network.turn) > CORNER, 0.0, np.abs(network.turn))
    before = network.segment(edge, offset)[0]
    near = [np.abs(offset - network.distance[v]) <= 0.5 * KINK for v in (before, before + 1)]
    return np.asarray(np.maximum(turn[before] * near[0], turn[before + 1] * near[1]) / KINK)


def across(limit: Floats, edge: NDArray[Any], s: Floats, inside: Mask) -> Floats:
    """(N,) limits of roads, but the mean of two where they meet."""
    out = limit.copy()
    for i in np.flatnonzero((np.diff(edge) != 0) & (np.diff(limit) != 0.0) & inside[1:]).tolist():
        out[np.searchsorted(s, s[i] - CENTRE) : np.searchsorted(s, s[i] + CENTRE)] = limit[i : i + 2].mean()
    return out


def _windows(parts: list[Leg], length: float) -> Ints:
    """(G,) window of each node: ``length`` metres of one leg; the last takes the rest."""
    out, base = [], 0
    for leg in parts:
        count = max(int(leg.distance[-1] // length), 1)
        out.append(base + np.minimum((leg.distance // length).astype(np.int64), count - 1))
        base += count
    return np.concatenate(out)


@dataclass(frozen=True)
class Lost:
    """Time lost to other trucks. ``share`` of the travel time and its standard ``error``; ``touched`` the
    share of the time with another truck in the way; (C,) by stretch of lane: seconds ``lost`` with their
    ``spread``, ``time`` spent there [s] and ``passages``; ``p_value`` that as much is lost by chance."""

    share: float
    error: float
    touched: float
    lost: Floats
    spread: Floats
    time: Floats
    passages: NDArray[np.intp]
    p_value: float


Passed = tuple[Path, Mask, Ints, Floats, Floats]
"""A path, in which of its windows nobody was in the way, (W,), the trips of these, (W,), and at its nodes,
(G,), the seconds that trucks are known to wait, whoever is there, and those that the free drive takes."""


def usual_time(passed: Iterable[Passed], lanes: Stretches) -> Floats:
    """(2, C) by stretch of lane, where nobody was in the way: time beyond the free drive, and by it."""
    total = np.zeros((2, len(lanes)))
    for path, whole, _, _, free in passed:
        cell, plain = lanes.at(path.motion)[0].astype(np.int64), whole[path.of]
        total += [np.bincount(cell, plain * v, len(lanes)) for v in (path.took - path.standing - free, free)]
    return total


def lost_time(
    passed: Iterable[Passed], lanes: Stretches, usual: Floats, known: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return sums of the time lost beyond the :func:`usual_time`: (7,) over trips, and (4, C) by stretch of
    lane. ``known`` (C,) is the share of the time there that is known to be lost: it is left out."""
    size = len(lanes)
    total, places = np.zeros(7), np.zeros((4, size))
    longer = (usual[0] + OWN * float(usual[0].sum()) / max(float(usual[1].sum()), 1e-9)) / (usual[1] + OWN)
    for path, _, of_window, waits, free in passed:
        cell, behind = lanes.at(path.motion)[0].astype(np.int64), path.behind[path.of]
        over = behind * (path.took - path.standing - free - waits - longer[cell] * free)
        over -= 0.0 if known is None else known[cell] * path.took
        trips, trip = np.unique(of_window[path.of], return_inverse=True)
        pair, which = np.unique(trip * size + cell, return_inverse=True)
        lost, at = np.bincount(which, over), pair % size  # A trip passes few stretches
        places[:3] += [np.bincount(at, v, size) for v in (lost, lost**2, lost != 0.0)]
        places[3] += np.bincount(cell, path.took, size)
        own, took = np.bincount(trip, over), np.bincount(trip, path.took)
        touched = float((behind * path.took).sum())
        total += [len(trips), own.sum(), took.sum(), touched, own @ own, own @ took, took @ took]
    return total, places


def lost(total: Floats, places: Floats) -> Lost | None:
    """Return the time lost by its sums; None where nobody was in the way."""
    count, own, took, touched, square, both, size = total.tolist()
    if not touched:
        return None
    share, trips = own / took, max(count, 2.0)
    scatter = max(square - 2.0 * share * both + share**2 * size, 0.0)
    error = float(np.hypot(np.sqrt(scatter * trips / (trips - 1.0)), MODEL * touched) / took)
    return Lost(
        share, error, touched / took, places[0], np.sqrt(places[1]), places[3], places[2].astype(np.intp),
        float(stdtr(trips - 1.0, -share / max(error, 1e-12))),
    )  # fmt: skip
