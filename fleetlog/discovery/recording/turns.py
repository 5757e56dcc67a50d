"""How each way over a junction is driven: maps hold neither lanes nor curves, so turns are measured on the
trucks themselves.

Undisturbed passages tell the speed, positions where the bend lies.  Before it, or where the way goes straight
on, drivers slow down most where they see whether they must give way.  Only how one way over a junction
differs from another is taken from there; what all have in common stays the model's to explain.  Where the
corners of the map, rounded with the radius of the truck, explain the speeds seen better, they are kept."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fleetlog.core.arrays import Floats, Index, Mask
from fleetlog.core.truck import Truck
from fleetlog.physics.motion.legs import Leg
from fleetlog.store.trips import MIN_LOAD_CHANGE

Way = tuple[int, int]  # Edges before and behind a junction
Slow = tuple[float, float, float]  # Middle and half length of a place [m], speed there [m/s]
Seen = tuple[Leg, Floats, Mask]  # A leg with its free speed (N,) and the nodes that count (N,)

FEWEST = 3  # Passages from which on a way over a junction is known
REACH = 10.0  # Half the way on which a junction is crossed [m]
BEFORE, BEHIND = 24.0, 14.0  # A truck that brakes for a junction does so from here on; and is past it [m]
PLACES = np.arange(-BEFORE, BEHIND + 0.5)  # Where speeds about a junction are looked at [m]
CENTRE = 5.0  # Half the place where roads meet: limits, and slow zones, of one road end before the other [m]
HALVES = (0.5, 2.0, 4.0)  # Half the way on which trucks go slowly before they go on [m]
DIP = 0.9  # Slowing down by less than this share costs less than 0.1 s
CLEAR = 14.0  # Nearer to a stop, the speed at a junction is that of setting off or stopping [m]
BEND, BACK = 0.6, 2.6  # A smaller turn is none; a larger one is a turn on the spot [rad]
DRIVEN = 0.7  # Quantile of undisturbed speeds that is meant: some dawdle, or meet what nobody recorded
SHORTEST = 1.0  # Shortest bend [m]
BLUR = 1.0 / 3.0  # Variance of the stretch over which a course is taken here [m2]
ALIKE = 0.65  # Of the nominal acceleration, in bends or behind; above, nothing here tells it from that


@dataclass(frozen=True)
class Turn:
    """A way over a junction. ``angle`` [rad]; ``length`` of its bend [m]; ``speed`` driven and ``free`` speed
    [m/s]; ``curvature`` by the map [1/m]; ``slow``, where trucks go slowly: middle (about the meeting of the
    edges) and half length [m], and speed [m/s]."""

    angle: float
    length: float
    speed: float
    free: float
    curvature: float
    slow: tuple[Slow, ...] = ()


@dataclass(frozen=True)
class Turns:
    """Ways over junctions, and the lateral acceleration at which their speeds are those driven [m/s2]; how
    trucks turn ``back`` on their road where nothing is known of the way, None where they were not seen to."""

    by_way: dict[Way, Turn]
    lateral: float
    back: Turn | None = None

    def along(self, s: Floats, edge: Index, curvature: Floats, inside: Mask, reverse: Index) -> Floats:
        """Return the (N,) curvature of legs laid end to end with that of their turns by their speed; ``s``
        [m] and ``edge`` of every node, ``inside`` whether the one before it is of the same leg; ``reverse``
        (E,) the edge that leads back, -1 where there is none."""
        if not self.by_way:
            return curvature
        out, begin = curvature.copy(), np.flatnonzero(~inside)
        ends, known = np.append(begin[1:], len(s)), []
        for i in np.flatnonzero((np.diff(edge) != 0) & inside[1:]).tolist():
            back = self.back if reverse[edge[i]] == edge[i + 1] else None
            if (turn := self.by_way.get((int(edge[i]), int(edge[i + 1])), back)) is not None:
                k = int(np.searchsorted(begin, i, side="right")) - 1
                known.append((s[i], turn, slice(begin[k], ends[k])))
        for place, _, leg in known:
            out[leg][np.abs(s[leg] - place) < 0.7 * REACH] = 0.0
        for place, turn, leg in known:
            for middle, half, speed in turn.slow:
                bend = np.abs(s[leg] - place - middle) <= half
                out[leg][bend] = np.maximum(out[leg][bend], self.lateral / speed**2)
        return out


@dataclass(frozen=True)
class Pass:
    """One way over a junction as it was driven."""

    s: Floats  # About the meeting of the edges [m]
    speed: Floats
    free: float
    curvature: float
    turned: Floats
    at: Floats
    spacing: float
    profile: Floats  # Speed at all places, NaN where it does not count
    laden: bool


def crossings(drives: Iterable[Seen]) -> Iterator[tuple[Way, Pass]]:
    """Yield how legs cross junctions."""
    for leg, free, use in drives:
        edge = leg.path.edge
        for i in np.flatnonzero(np.diff(edge) != 0).tolist():  # The last node before each junction
            if (one := _pass(leg, free, use, i)) is not None:
                yield (int(edge[i]), int(edge[i + 1])), one


def measure(found: Iterable[tuple[Way, Pass]], truck: Truck) -> Turns:
    """Return the turns that were crossed so."""
    passes: dict[Way, list[Pass]] = defaultdict(list)
    for way, one in found:
        passes[way].append(one)
    seen = {way: p for way, p in _as_unladen(passes).items() if len(p) >= FEWEST}
    usual = _as_gathered(seen.values(), truck)
    known = {way: _turn(p, usual) for way, p in seen.items()}
    backs = {way: t for way, t in known.items() if abs(t.angle) > BACK}
    ahead = [t for way, t in known.items() if way not in backs]
    bends = [t for t in ahead if abs(t.angle) > BEND]
    level = nominal = truck.drive.max_lateral_acceleration
    # Who is as slow where the way goes straight on stops or gives way there, and not for a bend or corner.
    straight = [min((v for *_, v in t.slow), default=t.speed) for t in ahead if abs(t.angle) <= BEND]
    bind = np.median(straight or np.inf) > np.median([t.speed for t in bends] or 0.0)
    if len(bends) < FEWEST or (bind and _map_explains(ahead)):
        known = backs  # No map tells how trucks turn back
    elif bind:
        level = float(np.median([t.speed**2 for t in bends])) / truck.chassis.turn_radius
    back = sorted(backs.values(), key=lambda t: t.speed)[len(backs) // 2] if backs else None
    return Turns(known, level if level < ALIKE * nominal else nominal, back)


def _pass(leg: Leg, free: Floats, use: Mask, i: int) -> Pass | None:
    d, place = leg.distance, leg.distance[i]
    near = slice(np.searchsorted(d, place - REACH, side="right"), np.searchsorted(d, place + REACH))
    if min(place - d[0], d[-1] - place) < CLEAR or not use[near].all():
        return None
    s, x, y, speed = d[near] - place, leg.path.x[near], leg.path.y[near], leg.path.speed[near]
    turned = np.diff(np.unwrap(np.arctan2(y[4:] - y[:-4], x[4:] - x[:-4])))
    curvature = float(np.abs(leg.path.curvature[near]).max())
    middle = 0.5 * (s[3:-2] + s[2:-3])
    profile = np.interp(place + PLACES, d, np.where(use, leg.path.speed, np.nan), left=np.nan, right=np.nan)
    own = float(free[near].min())
    laden = bool(leg.path.payload[i] > MIN_LOAD_CHANGE)
    return Pass(s, speed, own, curvature, turned, middle, float(np.median(speed)), profile, laden)


def _as_unladen(passes: dict[Way, list[Pass]]) -> dict[Way, list[Pass]]:
    """Passages with the speeds of trucks without a load: what a load changes is the model's to explain, and
    no way's own. Ways crossed with and without one tell how much that is, of bends and of the rest."""
    bends = {way: abs(_angle(own)) >= BEND for way, own in passes.items()}
    ratios: dict[bool, list[float]] = {False: [], True: []}
    for way, own in passes.items():
        empty, laden = ([float(p.speed.min()) for p in own if p.laden == loaded] for loaded in (False, True))
        if min(len(empty), len(laden)) >= FEWEST:
            ratios[bends[way]].append(float(np.median(laden) / np.median(empty)))
    out = {}
    for way, own in passes.items():
        r = np.median(ratios[bends[way]] or [1.0])
        out[way] = [replace(p, speed=p.speed / r, profile=p.profile / r) if p.laden else p for p in own]
    return out


def _as_gathered(ways: Iterable[list[Pass]], truck: Truck) -> Truck:
    """The truck with the acceleration behind bends that ways have in common: that is no way's own."""
    rates = list[float]()
    for driven in [_driven(passes) for passes in ways if abs(_angle(passes)) > BEND]:
        slow = driven < DIP * np.nanmax(driven[PLACES > 0.0], initial=0.0)
        gathers = np.diff(driven**2)[(PLACES > 0.0)[1:] & slow[1:] & (np.diff(driven) > 0.0)]
        rates += [0.5 * float(np.quantile(gathers, DRIVEN))] if len(gathers) >= FEWEST else []
    drive, most = truck.drive, float(np.median(rates)) if len(rates) >= FEWEST else np.inf
    slowly = most < ALIKE * drive.max_acceleration  # Hardly more slowly is how people drive.
    return replace(truck, drive=replace(drive, max_acceleration=most)) if slowly else truck


def _angle(passes: list[Pass]) -> float:
    return float(np.median([p.turned.sum() for p in passes]))


def _driven(passes: list[Pass]) -> Floats:
    """Speeds at all places that are driven where nobody is in the way, (K,) [m/s]; NaN where few did."""
    profile, driven = np.stack([p.profile for p in passes]), np.full(len(PLACES), np.nan)
    seen = np.isfinite(profile).sum(axis=0) >= FEWEST
    driven[seen] = np.nanquantile(profile[:, seen], DRIVEN, axis=0)
    return driven


def _turn(passes: list[Pass], truck: Truck) -> Turn:
    """What passages have in common."""
    angle = _angle(passes)
    free, curvature = (float(np.median([getattr(p, n) for p in passes])) for n in ("free", "curvature"))
    driven = _driven(passes)
    if abs(angle) < BEND:
        return Turn(angle, 0.0, _speed(passes, 0.0, 2.0), free, curvature, _dip(driven, truck, ()))
    turned, at = np.concatenate([p.turned for p in passes]), np.concatenate([p.at for p in passes])
    weight = turned / turned.sum()
    middle = float(np.clip(weight @ at, -0.5 * REACH, 0.5 * REACH))
    # Between two rows the way is straight here: that widens the bend.
    blur = BLUR + float(np.mean([p.spacing**2 for p in passes])) / 6.0
    variance = float(weight @ (at - middle) ** 2) - blur
    length = float(np.clip(np.sqrt(12.0 * max(variance, 0.0)), SHORTEST, 1.5 * REACH))
    speed = _speed(passes, middle, max(0.5 * length, 2.0))
    bend = _slowest(driven, truck, (middle, max(0.5 * length, 0.3), speed))
    return Turn(angle, length, speed, free, curvature, (bend, *_dip(driven, truck, (bend,))))


def _slowest(driven: Floats, truck: Truck, bend: Slow) -> Slow:
    """The part of a bend on which trucks are as slow as in it, by the speeds driven: a truck that turns back
    is that for a moment."""
    middle, half, speed = bend
    inner = [float(at) for at in PLACES if abs(at - middle) < half]
    tried = [bend, *((at, h, speed) for h in HALVES if h < half for at in inner)]
    return _likest(driven, truck, np.nanmax(driven, initial=speed), tried)


def _likest(driven: Floats, truck: Truck, known: float | Floats, tried: list[Slow]) -> Slow:
    """The place with which times per metre are likest those driven, where speeds ``known`` hold as well."""
    missed = [np.nansum((1.0 / np.minimum(known, _beside(t, truck)) - 1.0 / driven) ** 2) for t in tried]
    return tried[int(np.argmin(missed))]


def _beside(one: Slow, truck: Truck) -> Floats:
    """The fastest drive, (K,) [m/s], at all places beside one that is slow."""
    middle, half, speed = one
    apart = np.maximum(np.abs(PLACES - middle) - half, 0.0)
    drive = truck.drive
    rate = np.where(middle > PLACES, drive.max_deceleration, drive.max_acceleration)
    return np.asarray(np.sqrt(speed**2 + 2.0 * rate * apart))


def _dip(driven: Floats, truck: Truck, bends: tuple[Slow, ...]) -> tuple[Slow, ...]:
    """Where trucks slow down most that ``driven`` speeds at all places tell, (K,), beside the bends; nowhere
    where they slow down for the bends alone, or since one of the roads is slow."""
    before, behind = driven[PLACES <= -CENTRE], driven[PLACES >= CENTRE]
    if not (np.isfinite(before).any() and np.isfinite(behind).any()):
        return ()
    roads = (-BEFORE, BEFORE, float(np.nanmax(before))), (BEFORE, BEFORE, float(np.nanmax(behind)))
    known = np.min([_beside(one, truck) for one in (*roads, *bends)], axis=0)
    inner = (np.abs(PLACES) <= BEHIND) & (min([b[0] - b[1] for b in bends], default=CENTRE) > PLACES)
    slow = np.flatnonzero(inner & (driven < DIP * known))
    tried = [(float(PLACES[k]), half, float(driven[k])) for k in slow for half in HALVES]
    return (_likest(driven, truck, known, tried),) if tried else ()


def _speed(passes: list[Pass], middle: float, reach: float) -> float:
    """The speed intended there: what lies before or behind may be slow for a reason of its own."""
    slowest = [float(p.speed[np.abs(p.s - middle) <= reach].min()) for p in passes]
    return max(float(np.quantile(slowest, DRIVEN)), 0.1)


def _map_explains(known: list[Turn]) -> bool:
    """Whether corners of the map, at one lateral acceleration, tell better than bends where trucks slow."""
    speed, free, corner = (np.array([getattr(t, n) for t in known]) for n in ("speed", "free", "curvature"))
    bend = np.array([abs(t.angle) / max(t.length, SHORTEST) if abs(t.angle) > BEND else 0.0 for t in known])

    def missed(curvature: Floats) -> float:
        caps = (np.sqrt(lateral / np.maximum(curvature, 1e-6)) for lateral in np.geomspace(0.1, 10.0, 60))
        return min(float(np.sum((np.minimum(free, cap) / speed - 1.0) ** 2)) for cap in caps)

    return missed(corner) < missed(bend)
