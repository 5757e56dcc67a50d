"""What the compiled loop of the simulator sees: the roads, and every truck, as arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.truck import Truck

Floats = NDArray[np.float64]
Index = NDArray[np.int32]

PARKED, HANDLING, WANTS_OUT, LEAVING, DRIVING, AT_BAY, ENTERING, CHARGING, EMPTY = range(9)
"""What a truck does: stands in a bay, works there, waits to leave it, backs out, drives, waits on the road before its bay,
goes in, charges, or stands with an empty battery."""


class Roads(NamedTuple):
    """P pieces, E lanes, S samples, B bays, R resources; see Track, Junctions and Bay for the meaning."""

    first: NDArray[np.int64]
    spacing: Floats
    length: Floats
    slope: Floats
    cap: Floats
    """(2, S) highest speed without and with a load, braking ahead of every bend of the piece included [m/s]."""
    clear: Floats
    stop: Floats
    capacity: Index
    bent: NDArray[np.bool_]
    conflict_first: NDArray[np.int64]
    conflicts: Index
    bay_lane: Index
    bay_at: Floats
    bay_length: Floats
    bay_ahead: Floats


class Limits(NamedTuple):
    """Numbers of the truck and of the rules."""

    length: float
    gap: float
    up: float
    down: float
    plan: float
    """Braking that a driver plans with; a little less than he has [m/s2]."""
    power: float
    rolling: float
    mass: float
    creep: float
    """On a spur [m/s]."""
    patience: float
    """After this wait [s] a truck asks others for room."""


class Fleet(NamedTuple):
    """V trucks; and the queues and reservations on the roads."""

    mode: NDArray[np.int8]
    piece: Index
    s: Floats
    v: Floats
    a: Floats
    spur: Floats
    bay: Index
    goal: Index
    route: Index
    at: Index
    last: Index
    held_from: Index
    held_to: Index
    ahead: Index
    behind: Index
    waits: Floats
    load: Floats
    trip: Index
    hand_start: Floats
    hand_height: Floats
    hand_times: Floats
    hand_before: Floats
    hand_after: Floats
    until: Floats
    attention: NDArray[np.bool_]
    force: NDArray[np.bool_]
    left: Index
    left_by: Floats
    left_hold: Floats
    tail: Index
    on: Index
    inbound: Index
    last_out: Index
    asks: Index
    held: Index
    claimed: NDArray[np.int64]
    round: NDArray[np.int64]
    why: NDArray[np.int8]
    """Why a truck waits: 0 does not, 1 others are in the way, 2 no room behind the junction."""
    moved: Floats
    line: Index
    """Those who ask for a reservation, longest wait first."""


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
    mode: NDArray[np.int8]


def new_log(trucks: int, steps: int) -> Log:
    """An empty log."""
    shape = (trucks, steps)
    s, v, a, height, lift, load = (np.zeros(shape) for _ in range(6))
    return Log(
        np.zeros(shape, np.int32),
        s,
        v,
        a,
        height,
        lift,
        load,
        np.zeros(shape, np.int32),
        np.zeros(shape, np.int8),
    )


def new_fleet(trucks: int, lanes: int, pieces: int, resources: int, longest: int) -> Fleet:
    """Trucks that are nowhere yet."""

    def ints(n: int, value: int = 0) -> Index:
        return np.full(n, value, np.int32)

    def zeros() -> Floats:
        return np.zeros(trucks)

    n = trucks
    return Fleet(
        mode=np.zeros(n, np.int8), piece=ints(n, -1), s=zeros(), v=zeros(), a=zeros(), spur=zeros(), bay=ints(n, -1),
        goal=ints(n, -1), route=np.full((n, longest), -1, np.int32), at=ints(n), last=ints(n, -1), held_from=ints(n),
        held_to=ints(n, -1),
        ahead=ints(n, -1), behind=ints(n, -1), waits=np.full(n, np.inf), load=zeros(), trip=ints(n),
        hand_start=np.full(n, -np.inf), hand_height=zeros(), hand_times=np.zeros((n, 3)), hand_before=zeros(),
        hand_after=zeros(), until=np.full(n, np.inf), attention=np.ones(n, np.bool_), force=np.zeros(n, np.bool_),
        left=ints(n, -1), left_by=zeros(), left_hold=zeros(), tail=ints(pieces, -1), on=ints(lanes), inbound=ints(lanes),
        last_out=ints(lanes, -1), asks=ints(lanes, -1), held=ints(resources), claimed=np.zeros(resources, np.int64),
        round=np.zeros(1, np.int64), why=np.zeros(n, np.int8), moved=zeros(),
        line=ints(n),
    )  # fmt: skip


def limits_of(truck: Truck, gap: float) -> Limits:
    """The numbers of a truck."""
    d = truck.drive
    creep = min(
        1.0, d.max_speed, float(np.sqrt(d.max_lateral_acceleration * 0.5 * truck.chassis.turn_radius))
    )
    return Limits(
        truck.chassis.length, gap, d.max_acceleration, d.max_deceleration, 0.9 * d.max_deceleration, d.max_power,
        truck.resistance.rolling, truck.chassis.mass, creep, 15.0,
    )  # fmt: skip
