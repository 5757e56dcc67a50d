"""The bays of a site: at its places, and drawn along the roads where it has no places, or too few."""

import numpy as np

from fleetlog.core.site import Place, PlaceKind, Site
from fleetlog.errors import SiteError
from fleetlog.simulate.bays import OFF_ROADS, BayMaker
from fleetlog.simulate.doors import Bay, span
from fleetlog.simulate.junctions import GAP
from fleetlog.simulate.ways import main_part


def lay_out(site: Site, maker: BayMaker, vehicles: int, mined: frozenset[str], spots: int) -> list[str]:
    """Make bays at places and for ``spots`` trucks; notes, or :class:`SiteError` (see ``_at_place``)."""
    notes = _lasting_lanes(site, maker, mined)
    notes += [note for place in site.places if (note := _at_place(maker, place, place.id in mined))]
    notes += _drawn(site, maker, spots)
    room = sum(b.place.kind != "charge" for b in maker.bays)
    if vehicles > room - 1:
        raise SiteError(
            f"{vehicles} trucks are more than the site can hold: there is room to park {max(room - 1, 0)}",
            do="simulate fewer trucks or add roads and parking places",
        )
    return notes


def _lasting_lanes(site: Site, maker: BayMaker, mined: frozenset[str]) -> list[str]:
    """Restrict bays to the lanes that lead to one another and to most of the places."""
    network, near = maker.track.network, []
    for place in site.places:
        lanes = maker.lanes_near(place.x, place.y)
        if place.id not in mined and (not lanes or lanes[0][0] > OFF_ROADS):
            raise SiteError(
                f"place {place.id!r} at ({place.x:.1f}, {place.y:.1f}) is off the roads",
                do=f"move it to within {OFF_ROADS:.0f} m of a road, or draw the road that leads there",
            )
        near.append(np.array([lane for _, lane, _ in lanes], dtype=np.int64))
    maker.lasting = main_part(network, near)
    out = float(network.length[~maker.lasting].sum())
    if not out:
        return []
    return [
        f"{int((~maker.lasting).sum())} of {len(network)} lanes ({out:.0f} m) cannot be reached and left"
        " again: nobody stops there"
    ]


def _at_place(maker: BayMaker, place: Place, mined: bool) -> str | None:
    """Make the bays of a place; what to say where it gets none."""
    if not mined and not maker.lanes_near(place.x, place.y):
        return f"place {place.id!r} cannot be reached from the others and left again: it is left out"
    wanted = max(place.plugs, 1)
    made = sum(maker.place(place) is not None for _ in range(wanted))
    if made >= (wanted if place.kind == "charge" and not mined else 1):
        return None
    if mined:
        return f"no room for a truck beside the road at the mined place {place.id!r}: it is left out"
    raise SiteError(
        f"no room for a truck of {maker.truck.chassis.length:g} m beside the road at place {place.id!r}",
        do="move the place to a longer stretch of road, or away from its neighbours",
    )


def _drawn(site: Site, maker: BayMaker, vehicles: int) -> list[str]:
    """Draw the bays that the site lacks; what to say about them."""
    notes, kinds = [], {b.place.kind for b in maker.bays}
    if not site.places:
        made = auto_places(maker, max(24, 3 * vehicles))
        return [
            f"the site has no places: {len(made)} parking, pick and drop spots were drawn along its roads"
        ]
    if not kinds & {"pick", "drop"}:
        made = auto_places(maker, max(12, 2 * vehicles), ("pick", "drop"))
        notes.append(f"the site has no pick or drop place: {len(made)} were drawn along its roads")
    free = sum(b.place.kind != "charge" for b in maker.bays)
    if free < 2 * vehicles + 2:
        made = auto_places(maker, 2 * vehicles + 2 - free, ("park",), "spot")
        if made:
            notes.append(
                f"{len(made)} further parking spots were drawn along the roads for {vehicles} trucks"
            )
    return notes


def auto_places(
    maker: BayMaker, wanted: int, kinds: tuple[PlaceKind, ...] = ("park", "pick", "drop"), name: str = ""
) -> list[Bay]:
    """Bays evenly over the roads, at most ``wanted``, called after their kinds or a ``name``."""
    pitch, radius = maker.truck.chassis.width + 2.0 * GAP, maker.truck.chassis.turn_radius
    spots: list[tuple[bool, float, int, float]] = []
    for lane in np.flatnonzero(maker.lasting).tolist():
        low, high = span(maker.track, maker.junctions, lane)
        n = int(max(high - low, 0.0) / pitch)
        for i in range(n):
            at = low + (i + 0.5) / n * (high - low)
            # First those that both lanes of a road lead to; of these the middle of a lane, then its quarters
            # ..., by the binary digits mirrored (van der Corput): a few bays lie spread over all roads.
            spread = int(f"{i:b}"[::-1], 2) / 2 ** i.bit_length()
            spots.append((not maker.from_both(lane, at, radius), spread, lane, at))
    made: list[Bay] = []
    for *_, lane, at in sorted(spots):
        if len(made) >= wanted:
            break
        kind = kinds[len(made) % len(kinds)]
        spot = maker.track.first[lane] + int(at / maker.track.spacing[lane])
        x, y = float(maker.track.x[spot]), float(maker.track.y[spot])
        bay = maker.along(lane, at, Place(f"{name or kind}-{len(made) + 1}", kind, x, y))
        if bay is not None:
            made.append(bay)
    return made
