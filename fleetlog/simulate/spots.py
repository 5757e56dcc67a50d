"""Bays drawn along the roads of a site that has no places, or too few."""

from __future__ import annotations

from fleetlog.core.site import Place
from fleetlog.simulate.bays import BayMaker
from fleetlog.simulate.junctions import GAP
from fleetlog.simulate.spurs import Bay, span


def auto_places(maker: BayMaker, wanted: int, kinds: tuple[str, ...] = ("park", "pick", "drop")) -> list[Bay]:
    """Bays evenly over the roads; at most ``wanted``."""
    pitch, radius = maker.truck.chassis.width + 2.0 * GAP, maker.truck.chassis.turn_radius
    spots: list[tuple[bool, float, int, float]] = []
    for lane in range(maker.lanes):
        low, high = span(maker.track, maker.junctions, lane)
        n = int(max(high - low, 0.0) / pitch)
        for i in range(n):
            at = low + (i + 0.5) / n * (high - low)
            # First those that both lanes of a road lead to; of these the middle of a lane, then its quarters ...: a few
            # bays lie spread over all roads.
            spots.append((not maker.from_both(lane, at, radius), _spread(i), lane, at))
    made: list[Bay] = []
    for *_, lane, at in sorted(spots):
        if len(made) >= wanted:
            break
        kind = kinds[len(made) % len(kinds)]
        spot = maker.track.first[lane] + int(at / maker.track.spacing[lane])
        place = Place(f"{kind}-{len(made) + 1}", kind, float(maker.track.x[spot]), float(maker.track.y[spot]))  # type: ignore[arg-type]  # one of the kinds above
        bay = maker.along(lane, at, place)
        if bay is not None:
            made.append(bay)
    return made


def _spread(i: int) -> float:
    """Van der Corput's sequence of base 2: an order in which any first few are far apart."""
    out, share = 0.0, 0.5
    while i:
        out += share * (i & 1)
        i, share = i >> 1, share / 2.0
    return out
