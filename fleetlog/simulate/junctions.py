"""Where trucks on different pieces would touch: where on a lane it is safe to stand, what excludes what.

A *resource* is a part of the track that only some trucks may be on at a time.  With P pieces and E lanes: a
connector or a lane without a safe part is resource p (its own number); the last metres of a lane are
resource P + lane, the first ones P + E + lane; spur k of a place is P + 2 E + k."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.arrays import Floats, Index, Ints, Mask, levels
from fleetlog.core.truck import Truck
from fleetlog.simulate.track import Track
from fleetlog.store.trips import runs

MARGIN = 0.15  # Kept free round every truck [m]
GAP = 1.0  # Between standing trucks, bumper to bumper [m]
STOP = 0.05  # A truck that waits keeps this far from the end of its lane [m]
START = 0.2  # At the very start of a lane a truck would have to stop before it is on it [m]
BEND = 0.02  # A connector that bends more than this takes one truck at a time [1/m]


@dataclass(frozen=True)
class Junctions:
    """E lanes, P pieces.

    clear, stop : (E,) a truck whose centre is between these offsets [m] touches nothing that others use; stop
        < clear where there is no such part (single-lane aisles, stubs).
    capacity : (E,) trucks that can stand on the safe part.
    resource : (S,) of every sample of the track, -1 on safe parts.
    conflicts : (N, 2) resources that exclude each other, or themselves: they take one truck at a time."""

    clear: Floats
    stop: Floats
    capacity: Index
    resource: Index
    conflicts: Ints


def half_box(truck: Truck) -> tuple[float, float]:
    """Half length and half width [m] of the footprint with its margin."""
    return 0.5 * truck.chassis.length + MARGIN, 0.5 * truck.chassis.width + MARGIN


def find_junctions(track: Track, truck: Truck) -> Junctions:
    """Safe parts of all lanes, and the conflicts between everything else."""
    from fleetlog.simulate.kernels.geometry import meetings

    lanes, owner = len(track.network), track.owner
    every = np.ones(len(owner), dtype=np.bool_)
    pairs = meetings(track.x, track.y, track.z, track.heading, owner, every, *half_box(truck))
    a, b = owner[pairs[:, 0]], owner[pairs[:, 1]]
    touched = np.zeros(len(owner), dtype=bool)
    # The rule of following holds between those that a truck drives one after the other.
    touched[pairs[~_in_line(track, a, b)].ravel()] = True
    clear, stop = np.zeros(lanes), np.full(lanes, -1.0)
    resource = owner.copy()
    for lane in range(lanes):
        low, high, step = track.first[lane], track.first[lane + 1], track.spacing[lane]
        begin, end = max(runs(~touched[low:high]), key=lambda run: run[1] - run[0], default=(0, 0))
        if (last := min((end - 1) * step, track.length[lane] - STOP)) >= START:
            clear[lane], stop[lane] = begin * step, max(last, begin * step)
            resource[low:high] = len(track) + lane
            resource[low : low + begin] += lanes
            resource[low + begin : low + end] = -1
    room = truck.chassis.length + GAP
    capacity = np.where(stop >= clear, 1 + np.floor((stop - clear) / room), 0).astype(np.int32)
    bent = (np.maximum.reduceat(np.abs(track.curvature), track.first[:-1]) > BEND) & (track.source >= 0)
    ra, rb = resource[pairs[:, 0]], resource[pairs[:, 1]]
    keep = (ra >= 0) & (rb >= 0) & (ra != rb)
    apart = unique_pairs(ra[keep], rb[keep])
    apart = apart[~_in_line(track, *apart.T)]
    conflicts = np.append(apart, np.tile(np.flatnonzero(bent)[:, None], 2), axis=0)
    return Junctions(clear, stop, capacity, resource, conflicts)


def unique_pairs(a: NDArray[np.integer], b: NDArray[np.integer]) -> Ints:
    """(N, 2) each pair of numbers once, in order."""
    size = int(b.max(initial=0)) + 1
    key = levels(a.astype(np.int64) * size + b)
    return np.column_stack([key // size, key % size])


def lanes_at(track: Track, count: int) -> Ints:
    """(4, count) lanes of resources, -1: none; the one that a resource lies at the end of, the one that it
    lies at the start of, and those that it joins."""
    pieces, lanes = len(track), len(track.network)
    out = np.full((4, count), -1)
    out[:2, :lanes] = out[0, pieces : pieces + lanes] = np.arange(lanes)
    out[1, pieces + lanes : pieces + 2 * lanes] = np.arange(lanes)
    out[2:, :pieces] = track.source, track.target
    return out


def _in_line(track: Track, a: NDArray[np.integer], b: NDArray[np.integer]) -> Mask:
    """(N,) pairs of resources, or of pieces, that a truck takes one after the other."""
    out, at = np.zeros(len(a), dtype=bool), lanes_at(track, len(track) + 2 * len(track.network))
    # Lanes a, b that follow each other and do not lie side by side, each pair as one number.
    straight = (track.source >= 0) & ~track.swings
    turns = track.source[straight].astype(np.int64) * len(track) + track.target[straight]
    for one, other in ((a, b), (b, a)):
        leaves, _, source, target = at[:, one]
        left, entered, *_ = at[:, other]
        out |= (source >= 0) & ((left == source) | (entered == target))
        # Exit and entry of a lane, or exit of one and entry of the next, joined by a connector.
        goes_on = (leaves == entered) | np.isin(leaves * len(track) + entered, turns)
        out |= (leaves >= 0) & (entered >= 0) & goes_on
    return out
