"""What the compiled loop of the simulator sees: the roads, and every truck, as arrays; types of trucks."""

from collections import namedtuple
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index, Ints, Mask
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError

Modes = NDArray[np.int8]
PICK_PLACE, DROP_PLACE, CHARGER = 1, 2, 3  # What a truck that stands in a bay waits for; 0: nothing
PLAN = 0.9  # Share of its braking that a truck plans with
HAIR = 0.2  # A truck goes on for at most so long before it brakes: half of the longest step, and rounding [s]
STANDS = 0.05  # Slower than this a truck in traffic stands, and waits [m/s]
NOT_ZERO: dict[str, float] = {  # What trucks that are nowhere yet, and empty roads, begin with; else with 0
    "piece": -1, "door": -1, "goal": -1, "route": -1, "last": -1, "held_to": -1, "ahead": -1,
    "left": -1, "tail": -1, "last_out": -1, "asks": -1, "crossed": -1, "beside": -1, "waits": np.inf,
    "hand_start": -np.inf, "until": -np.inf, "attention": 1, "stood": -1,
}  # fmt: skip
PACES = ("speed_factor", "max_acceleration", "max_deceleration", "max_lateral_acceleration", "reaction")
DRIVER = dict.fromkeys(PACES, 1.0)  # What a driver asks of a truck; power follows from motion, whoever drives

_Modes = namedtuple("_Modes", "PARKED HANDLING WANTS_OUT LEAVING DRIVING AT_BAY ENTERING CHARGING EMPTY")
Mode = _Modes(*range(9))
"""What a truck does: it stands in a bay, works there, waits to leave it, backs out, drives, waits on the road
before its bay, goes in, charges, or stands with an empty battery. Plain numbers: NumPy compares an array with
a member of an enumeration ten times as slowly."""


class Roads(NamedTuple):
    """P pieces, E lanes, S samples, D doors, R resources; see Track, Junctions and Door for the meaning."""

    first: Ints
    spacing: Floats
    length: Floats
    slope: Floats
    cap: Floats
    """(2 K, S) highest speed of truck k without (row 2 k) and with a load (2 k + 1), braking ahead of every
    bend included [m/s]."""
    wait_first: Ints  # (K E + 1,) stops by terms that wait: those of truck k on lane e from k E + e on
    wait_at: Floats  # Where [m], in order
    wait_for: Floats  # For how long [s]
    walk_at: Floats  # (E,) where trucks stop when people cross the lane [m]; inf: nobody does
    run_in: Floats  # (E,) metres in which any truck that comes onto a lane can stop
    clear: Floats
    stop: Floats
    capacity: Index
    swings: Mask  # (P,) whether a truck turns so far that it comes back beside the lane that it left
    conflict_first: Ints  # (R + 1,) resource r excludes conflicts[conflict_first[r]:conflict_first[r + 1]]
    conflicts: Index
    door_lane: Index
    door_at: Floats
    door_length: Floats
    door_ahead: Floats
    door_crosses: Index
    door_low: Floats
    door_high: Floats
    door_off: Floats  # (D,) metres along a spur from which on a truck is off the lane that it comes from
    door_onto: Floats  # (D,) ... and from and up to which it is over the lane that the spur crosses
    door_over: Floats


class Limits(NamedTuple):
    """Numbers of the rules, and (V,) of the trucks."""

    length: float
    gap: float
    cap: Index  # Row of a truck's speeds in ``Roads.cap``
    up: Floats
    down: Floats
    plan: Floats  # Braking that a driver plans with; a little less than he has [m/s2]
    reaction: Floats
    power: Floats
    rolling: Floats
    mass: Floats
    creep: Floats  # On a spur [m/s]
    raises: Floats
    lowers: Floats
    patience: float  # After this wait [s] a truck asks others for room


class Fleet(NamedTuple):
    """V trucks; and the queues and reservations on the roads."""

    mode: Modes
    piece: Index
    s: Floats
    v: Floats
    a: Floats
    spur: Floats
    door: Index  # Of its bay while it stands there, then the one that it goes to
    goal: Index  # Door that it goes to when it has left its bay
    route: Index
    at: Index
    last: Index
    held_from: Index
    held_to: Index
    ahead: Index
    waits: Floats
    load: Floats
    trip: Index
    hand_start: Floats
    hand_height: Floats
    hand_times: Floats
    hand_before: Floats
    hand_after: Floats
    until: Floats  # A truck stands before: it works, waits as the term says, or its driver has to react [s]
    attention: Mask
    left: Index
    left_by: Floats
    left_hold: Floats
    tail: Index
    on: Index
    inbound: Index
    bound: Index  # (E,) trucks that are to go into a bay of a single-lane aisle, and not on it yet
    last_out: Index
    asks: Index  # (E,) the truck for which others stop on a lane, -1: none
    ask_at: Floats  # (E,) where they stop for it [m]
    crossed: Index  # (E,) one that is to cross a lane, or does, on its way into a bay or out, -1: none
    beside: Index  # (V,) another that crosses the same lane, -1: none
    crosses: Mask  # (V,) whether a truck is to cross a lane, or does
    walked: Mask  # (E,) whether people cross a lane now
    entry: Mask  # Whether a truck on the road has the ground of its bay reserved
    held: Index
    claimed: Ints
    round: Ints
    why: Modes  # Why a truck waits: 0 does not, 1 others are in the way, 2 no room behind the junction
    moved: Floats
    stood: Floats  # Up to here on its lane a truck has stood where it waits [m]
    line: Index  # Those who ask for a reservation, longest wait first


class Log(NamedTuple):
    """(V, steps) state at the start of every step."""

    piece: Index
    s: Floats
    v: Floats
    a: Floats
    height: Floats
    lift: Floats
    load: Floats
    trip: Index
    mode: Modes


def new_log(trucks: int, steps: int) -> Log:
    """An empty log."""
    kinds = {"piece": np.int32, "trip": np.int32, "mode": np.int8}
    return Log(*(np.zeros((trucks, steps), kinds.get(name, np.float64)) for name in Log._fields))


def new_fleet(trucks: int, lanes: int, pieces: int, resources: int, longest: int) -> Fleet:
    """Trucks that are nowhere yet, on empty roads; routes have at most ``longest`` pieces."""
    shape: dict[str, int | tuple[int, int]] = {
        "route": (trucks, longest), "hand_times": (trucks, 3), "tail": pieces, "held": resources,
        "claimed": resources, "round": 1,
        **dict.fromkeys(("on", "inbound", "bound", "last_out", "asks", "ask_at", "crossed", "walked"), lanes),
    }  # fmt: skip
    # NDArray[T] is an array of any shape of dtype[T].
    kinds = {name: get_args(get_args(hint)[1])[0] for name, hint in get_type_hints(Fleet).items()}
    return Fleet(*(np.full(shape.get(n, trucks), NOT_ZERO.get(n, 0), kinds[n]) for n in Fleet._fields))


def creep_speed(truck: Truck) -> float:
    """Speed on the way into a bay and out of it [m/s]."""
    d = truck.drive
    return min(1.0, d.max_speed, float(np.sqrt(d.max_lateral_acceleration * 0.5 * truck.chassis.turn_radius)))


def limits_of(kinds: Sequence[Truck], of: Index, length: float, gap: float) -> Limits:
    """The numbers of trucks of several kinds; ``of`` (V,) which each has."""

    def each(name: str) -> Floats:
        return np.array([truck.value(name) for truck in kinds])[of]

    down, creep = each("drive.max_deceleration"), np.array([creep_speed(truck) for truck in kinds])[of]
    return Limits(
        length, gap, 2 * of, each("drive.max_acceleration"), down, PLAN * down, each("drive.reaction"),
        each("drive.max_power"), each("resistance.rolling"), each("chassis.mass"), creep,
        each("lift.raise_speed"), each("lift.lower_speed"), 15.0,
    )  # fmt: skip


@dataclass(frozen=True)
class Trucks:
    """``kinds`` are the different trucks, with what their drivers ask of them; ``of`` (V,) which each has."""

    kinds: tuple[Truck, ...]
    of: Index
    own: tuple[Hashable, ...] = ()  # What else tells the kinds apart

    @classmethod
    def given(cls, trucks: Truck | Sequence[Truck], vehicles: int) -> "Trucks":
        """One truck a vehicle; of one truck alone as many as there are, the last of them its ``others``."""
        if isinstance(trucks, Truck):
            if len(others := [truck for truck, count in trucks.others for _ in range(count)]) > vehicles:
                what = f"trucks of other types ({len(others)}) are more than the vehicles ({vehicles})"
                do = "ask for more with --vehicles, or for fewer in the truck's [[fleet]]"
                raise DataError(what, do=do)
            trucks = [replace(trucks, others=())] * (vehicles - len(others)) + others
        kinds = tuple(dict.fromkeys(trucks))
        return cls(kinds, np.array([kinds.index(trucks[v % len(trucks)]) for v in range(vehicles)], np.int32))

    def __getitem__(self, v: int) -> Truck:
        return self.kinds[int(self.of[v])]

    @property
    def envelope(self) -> Truck:
        """The truck that the site is laid out for: as long, wide and strong as any, and as hard to turn."""
        names = ("length", "width", "turn_radius", "rated_load")
        sizes = {name: max(truck.value(f"chassis.{name}") for truck in self.kinds) for name in names}
        return replace(self.kinds[0], chassis=replace(self.kinds[0].chassis, **sizes))

    def alike(self, most: int) -> Iterator[slice]:
        """Groups of at most so many trucks, one after the other, that take the same power to move alike."""
        types = [replace(truck, drive=replace(truck.drive, **DRIVER)) for truck in self.kinds]
        different = list(zip(types, self.own or types, strict=True))
        kind = np.array([different.index(d) for d in different])[self.of]
        starts = np.concatenate([[0], np.flatnonzero(np.diff(kind)) + 1, [len(kind)]])
        for low, high in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
            yield from (slice(k, min(k + most, high)) for k in range(low, high, most))
