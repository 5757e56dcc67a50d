"""The site in a recording: roads, buildings, zones, places; without a map the ways driven."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from fleetlog.core.arrays import Floats
from fleetlog.core.network import Network
from fleetlog.core.site import Place, Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.simulate.track import shifted
from fleetlog.view import clock, palette, ribbons
from fleetlog.view.fleet import Lane
from fleetlog.view.stream import Stream, entity, ui_points

DEFAULT_WIDTH = 3.5  # Drawn width of a road [m] whose map gives none
MANY_LABELS, MANY_PLACES = 30, 8  # From here on labels, which would hide the floor, show under the pointer
POINTS_A_DAY = 4000
BREAK = 200.0  # A step longer than this [m] is a jump of the log, not a way
RAISED = np.array([0.0, 0.0, 0.05])  # Lines lie this much over the surfaces, not hidden in them [m]


def drawn_width(network: Network, edge: int) -> float:
    """Width of the road of an edge [m]."""
    width = float(network.width[edge])
    return width if width > 0.3 else DEFAULT_WIDTH


def lane(site: Site, edge: int) -> tuple[float, float]:
    """Rims of the strip on which an edge is driven [m left of its line]: half of a two-way road."""
    network = site.roads()
    half = drawn_width(network, edge) / 2.0
    if network.reverse[edge] < 0:
        return half, -half
    return (0.0, -half) if site.traffic == "right" else (half, 0.0)


def log_site(stream: Stream, site: Site) -> None:
    """Everything that the site has, under ``/site``."""
    if site.network is not None:
        _log_roads(stream, site.network, site)
    for building in site.buildings:
        height, outline = building.height, building.polygon
        roof = ribbons.floor_polygon(outline, height), palette.BUILDING
        sides = ribbons.walls(outline, 0.0, height), palette.BUILDING
        stream.static(entity("site", "buildings", "roofs", building.id), ribbons.mesh3d([roof], 28))
        stream.static(entity("site", "buildings", "walls", building.id), ribbons.mesh3d([sides], 40))
        posts = [np.array([[*p, 0.0], [*p, height]]) for p in ribbons.open_ring(outline)]
        foot, top = (ribbons.outline(outline, z) for z in (0.0, height))
        for part, lines in {"outlines": [foot], "frames": [top, *posts]}.items():
            strips = rr.LineStrips3D(lines, colors=[palette.BUILDING], radii=ui_points(0.7))
            stream.static(entity("site", "buildings", part, building.id), strips)
    for zone in site.zones:
        colour = palette.COVERED if zone.covered else palette.LIMITED
        floor = ribbons.floor_polygon(zone.polygon, 0.0), colour
        stream.static(entity("site", "zones", "floors", zone.id), ribbons.mesh3d([floor], 24))
        limit = "" if np.isnan(zone.speed_limit) else f" {zone.speed_limit:.2g} m/s"
        rim = rr.LineStrips3D(
            [ribbons.outline(zone.polygon, 0.02)], colors=[colour], radii=ui_points(1.0),
            labels=[zone.id + limit], show_labels=not zone.covered and len(site.zones) <= MANY_LABELS,
        )  # fmt: skip
        stream.static(entity("site", "zones", "rims", zone.id), rim)
    log_places(stream, site.places, "", len(site.places) <= MANY_PLACES)


def _log_roads(stream: Stream, network: Network, site: Site) -> None:
    surface, rims, marks, radius = [], [], [], np.zeros(len(network.node_ids))
    for i in range(len(network)):
        line, (left, right) = network.polyline(i), lane(site, i)
        two_way, ends = network.reverse[i] >= 0, [network.start[i], network.end[i]]
        radius[ends] = np.maximum(radius[ends], drawn_width(network, i) / 2.0)
        colour = palette.ROAD if two_way else palette.ONE_WAY
        surface.append((ribbons.ribbon(line, left, right, 0.01 if two_way else 0.03), colour))
        own = right if site.traffic == "right" else left  # The rim that the other direction does not share
        outer = (own,) if two_way else (left, right)
        rims += [shifted(line, o) + RAISED for o in outer]
        middle = shifted(line, (left + right) / 2.0)
        marks.append((ribbons.arrows(middle, min(1.6, 0.55 * (left - right)), 0.07), palette.ARROW))
    # Discs as wide as the widest road close the gaps between ribbons.
    nodes = zip(network.node_points, radius, strict=True)
    surface += [(ribbons.disc(x, y, r, z + 0.008, corners=20), palette.ROAD) for (x, y, z), r in nodes]
    stream.static("/site/roads/surface", ribbons.mesh3d(surface))
    lines = rr.LineStrips3D(rims, colors=[palette.ROAD_EDGE], radii=ui_points(0.6))
    stream.static("/site/roads/edges", lines)
    if any(len(arrows) for arrows, _ in marks):
        stream.static("/site/roads/arrows", ribbons.mesh3d(marks))
    if (frame := site.frame) is not None:
        once = [i for i in range(len(network)) if network.reverse[i] > i or network.reverse[i] < 0]
        on_earth = [np.column_stack(frame.to_geographic(*network.polyline(i)[:, :2].T)) for i in once]
        colours = [palette.ROAD_EDGE] * len(once)
        stream.static("/geo/roads", rr.GeoLineStrings(lat_lon=on_earth, colors=colours, radii=ui_points(1.2)))


def log_places(stream: Stream, places: Sequence[Place], part: str, labels: bool) -> None:
    """Rings on the floor, coloured by kind; ``part`` names a group beside the places of the site."""
    for kind in sorted({p.kind for p in places}):
        alike, colour = [p for p in places if p.kind == kind], palette.PLACES[kind]
        pads = [(ribbons.disc(p.x, p.y, 1.2, 0.09, inner=0.75), colour) for p in alike]
        stream.static(entity("site", "places", kind, part, "pads"), ribbons.mesh3d(pads))
        points = rr.Points3D(
            [[p.x, p.y, 0.1] for p in alike], radii=ui_points(2.5), colors=[colour],
            labels=[p.id for p in alike], show_labels=labels,
        )  # fmt: skip
        stream.static(entity("site", "places", kind, part, "points"), points)


def ways_of(t: Trajectory) -> list[Floats]:
    """Polylines (n, 2) of one day [m], broken at gaps and jumps, of at most some thousand points."""
    xy = np.column_stack([t.floats("x"), t.floats("y")])
    known = np.isfinite(xy).all(axis=1)
    xy, time = xy[known], t.time[known]
    if len(xy) < 2:
        return []
    step = np.hypot(*np.diff(xy, axis=0).T)
    cuts = np.flatnonzero((np.diff(time) > clock.gap_limit(time)) | (step > BREAK)) + 1
    every = max(1, len(xy) // POINTS_A_DAY)
    pieces = [p[np.unique(np.append(np.arange(0, len(p), every), len(p) - 1))] for p in np.split(xy, cuts)]
    return [p for p in pieces if len(p) > 1]


def log_ways(stream: Stream, of: Lane, ways: list[Floats]) -> None:
    """Draw them dimmed, so that the truck and its trail stand out."""
    if not ways:
        return
    tint, frame = [tuple(int(40 + 0.35 * c) for c in of.colour)], of.fleet.dataset.site.frame
    strips = [np.column_stack([w, np.zeros(len(w))]) for w in ways]
    lines = rr.LineStrips3D(strips, colors=tint, radii=ui_points(0.8))
    stream.static(entity("site", "driven", of.fleet.name, of.vehicle), lines)
    if frame is not None:
        on_earth = [np.column_stack(frame.to_geographic(*w.T)) for w in ways]
        drawn = rr.GeoLineStrings(lat_lon=on_earth, colors=tint * len(ways), radii=ui_points(1.0))
        stream.static(entity("geo", "driven", of.fleet.name, of.vehicle), drawn)
