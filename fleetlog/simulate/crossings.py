"""People on foot: zones of a site that close the roads through them at times."""

import numpy as np

from fleetlog.core.site import Site, Zone
from fleetlog.simulate.arrays import Flags, Floats
from fleetlog.simulate.track import Track

SHORT = 0.5
"""Trucks stop this far before such a zone [m]."""


def stops_before(site: Site, track: Track, length: float) -> Floats:
    """(Z, E) where trucks of a length stop on each lane before each zone that closes [m]; inf: nowhere."""
    lanes = len(track.network)
    samples = slice(0, track.first[lanes])
    zones = closing(site)
    out = np.full((len(zones), lanes), np.inf)
    for row, zone in zip(out, zones, strict=True):
        inside = np.flatnonzero(zone.contains(track.x[samples], track.y[samples]))
        lane = track.owner[inside]
        np.minimum.at(row, lane, (inside - track.first[lane]) * track.spacing[lane])
        row -= 0.5 * length + SHORT
        # Who cannot stand before the zone on its lane goes through.
        row[row <= 0.0] = np.inf
    return out


def closing(site: Site) -> list[Zone]:
    """Zones that close at times."""
    return [zone for zone in site.zones if zone.closed_every > 0.0]


class Crossings:
    """When people cross: after exponential times of a mean, each for as long; a function of the seed."""

    def __init__(self, site: Site, stops: Floats, seed: int) -> None:
        self._zones, self._lanes = closing(site), np.isfinite(stops)
        self._rng = [np.random.Generator(np.random.PCG64([seed, 11, k])) for k in range(len(self._zones))]
        self._begin = [r.exponential(z.closed_every) for r, z in zip(self._rng, self._zones, strict=True)]

    def tick(self, now: float, closed: Flags) -> None:
        """Mark the lanes that are ``closed`` (E,) at ``now`` [s]."""
        closed[:] = False
        for k, zone in enumerate(self._zones):
            while self._begin[k] + zone.closed_for <= now:
                self._begin[k] += zone.closed_for + self._rng[k].exponential(zone.closed_every)
            if self._begin[k] <= now:
                closed |= self._lanes[k]
