"""People on foot: zones of a site that close the roads through them at times."""

import numpy as np

from fleetlog.core.site import Site
from fleetlog.simulate.arrays import Flags, Floats
from fleetlog.simulate.track import Track

SHORT = 0.5
"""Trucks stop this far before such a zone [m]."""


def stops_before(site: Site, track: Track, length: float) -> Floats:
    """(Z, E) where trucks of a length stop on each lane before each zone that closes [m]; inf: nowhere."""
    lanes = len(track.network)
    samples = slice(0, track.first[lanes])
    out = np.full((len(closing(site)), lanes), np.inf)
    for row, zone in zip(out, closing(site), strict=True):
        inside = np.flatnonzero(site.zones[zone].contains(track.x[samples], track.y[samples]))
        lane = track.owner[inside]
        np.minimum.at(row, lane, (inside - track.first[lane]) * track.spacing[lane])
        row -= 0.5 * length + SHORT
        # Who cannot stand before the zone on its lane goes through.
        row[row <= 0.0] = np.inf
    return out


def closing(site: Site) -> list[int]:
    """Zones that close at times."""
    return [i for i, zone in enumerate(site.zones) if zone.closed_every > 0.0]


class Crossings:
    """When people cross: after exponential times of a mean, each for as long; a function of the seed."""

    def __init__(self, site: Site, stops: Floats, seed: int) -> None:
        zones = [site.zones[i] for i in closing(site)]
        self._rng = [np.random.Generator(np.random.PCG64([seed, 11, k])) for k in range(len(zones))]
        self._every = [(z.closed_every, z.closed_for) for z in zones]
        self._lanes = np.isfinite(stops)
        self._begin = np.array([r.exponential(e) for r, (e, _) in zip(self._rng, self._every, strict=True)])

    def tick(self, now: float, closed: Flags) -> None:
        """Mark the lanes that are ``closed`` (E,) at ``now`` [s]."""
        if not len(self._begin):
            return
        closed[:] = False
        for k, (every, lasts) in enumerate(self._every):
            while self._begin[k] + lasts <= now:
                self._begin[k] += lasts + self._rng[k].exponential(every)
            if self._begin[k] <= now:
                closed |= self._lanes[k]
