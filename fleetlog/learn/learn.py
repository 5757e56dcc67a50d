"""``fleetlog learn``: a site from a recording alone, every element with its evidence.

Of an existing map it tells what it lacks: roads driven and not in it, one-way roads driven against."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from fleetlog.core.arrays import Mask
from fleetlog.core.network import Network, build_network
from fleetlog.core.result import EdgeValues, Grid, Marks, Result, Shape
from fleetlog.core.site import Frame, Site, Zone
from fleetlog.core.words import Sentences
from fleetlog.errors import DataError
from fleetlog.learn.cells import SIDE, Driven, gather, moving
from fleetlog.learn.roads import SPEED_STEP, Evidence, Roads, Settings, learn_roads
from fleetlog.simulate.places import clusters, find_stands, mined_site, place_table, with_room
from fleetlog.store.dataset import Dataset
from fleetlog.store.results import write_result, write_site

SAID = Sentences(__file__)
COLUMNS = ("x", "y", "speed", "heading")
FREE = 0.95  # share of the rows on a road that are no faster than its speed limit as driven
FEW = 5  # with fewer rows no speed is told
MOST_SQUARES = 4_000_000  # squares of the picture of the traces
NEAR = 3.0  # a learned road within this of one of the map is that one [m]
ALIKE = np.cos(np.radians(45.0))
STEP = 1.0
SHORTEST = 5.0  # a shorter stretch is no proposal [m]
SLOW = 0.7  # roads driven at less than this share of the usual speed are a zone
SHORT_ZONE = 8.0  # a zone has this many metres of road at least
RIM = 2.0  # a zone reaches this far about its roads [m]
OPEN = 4.0  # an outline this many times as large as its roads says little
SAME, NONE = -2, -1  # where the map has the road, and where it has none


def learn(
    dataset: Dataset, *, site: Site | None = None, settings: Settings | None = None, min_visits: int = 3
) -> tuple[Site, Result]:
    """The site of a recording, and its evidence.

    dataset : recorded or simulated, with positions; it is read a few times, a day of a truck at a time.
    site : an existing one, to compare with: what it lacks is proposed.
    settings : see :class:`fleetlog.learn.roads.Settings`.
    min_visits : a place was visited this often at least.

    :class:`DataError` where the dataset has no positions, or no truck of it moved."""
    settings = settings or Settings()
    cells, noise = _driven(dataset)
    found = learn_roads(cells, noise, lambda: dataset.days(COLUMNS), settings)
    roads = described(found, noise)
    base = Site(dataset.path.name, dataset.site.frame, roads, dataset.site.traffic, zones=slow_zones(roads))
    stands = find_stands(dataset)
    cluster = clusters(stands, min_visits)
    places = place_table(stands, cluster)
    learned, names = mined_site(base, places)
    learned = with_room(learned, stands, cluster, names)
    room = {p.id: p.plugs for p in learned.places}
    places = places.assign(place=names, plugs=[room[n] for n in names])
    e, each = found.evidence, range(len(roads))
    table = pd.DataFrame({
        "edge_id": list(roads.edge_ids), "length_m": roads.length, "width_m": roads.width,
        "speed_limit": roads.speed_limit, "oneway": roads.reverse < 0, "passes": e.mean_passes(roads),
        "trucks": [len(e.vehicles.get(i, ())) for i in each], "days": [len(e.days.get(i, ())) for i in each],
    })  # fmt: skip
    lacking = proposals(roads, table, _in_frame(site, base.frame)) if site is not None else None
    return learned, _result(learned, cells, table, places, lacking, e)


def write_learned(site: Site, result: Result, folder: Path) -> None:
    """Write ``site.toml``, ``roads.geojson`` with every road's evidence, and the tables into ``folder``."""
    rows, names = result.tables["roads"].to_dict("records"), ("passes", "trucks", "days")
    write_site(site, folder, {row["edge_id"]: {name: row[name] for name in names} for row in rows})
    write_result(result, folder, site.frame)


def _in_frame(site: Site, frame: Frame | None) -> Network:
    """The roads of a site in another frame; as they are where either has no place on earth."""
    network = site.roads()
    if frame is None or site.frame in (None, frame):
        return network
    x, y = frame.to_local(*site.frame.to_geographic(*network.points[:, :2].T))
    return replace(network, points=np.column_stack([x, y, network.points[:, 2]]))


def _driven(dataset: Dataset) -> tuple[Driven, float]:
    noises: list[float] = []

    def tracks() -> Iterator[Driven]:
        for trajectory in dataset.days(COLUMNS):
            if trajectory.has("x") and trajectory.has("y"):
                track, noise = moving(trajectory)
                noises.append(noise)
                yield track

    if not len(cells := gather(tracks())):
        raise DataError("has no row in which a truck with a position moves", where=dataset.path,
                        do="import logs with positions")  # fmt: skip
    return cells, float(np.median(noises))


def described(found: Roads, noise: float) -> Network:
    """The learned network with widths, speed limits as driven and names."""
    n = found.network
    both = n.reverse >= 0
    names = [n.edge_ids[i] if both[i] else n.roads[i] for i in range(len(n))]
    # The speed that all but a few of the rows stay below [m/s]
    below = [np.cumsum(histogram) for histogram in found.evidence.speeds]
    free = [float((np.searchsorted(b, FREE * b[-1]) + 1) * SPEED_STEP) for b in below]
    limits = [math.nan if b[-1] < FEW else v for b, v in zip(below, free, strict=True)]
    # Of the floor that trucks' middles cover, or twice the gap between both directions' lines.
    apart = [2.0 * float(np.ptp(f.left)) if pair else 1.0 for f, pair in zip(found.fits, both, strict=True)]
    ways = zip(found.fits, both | found.forth, both | ~found.forth, apart, strict=True)
    widths = [round(max(fit.covered(np.array(way), noise), gap, 1.0), 2) for fit, *way, gap in ways]
    told = zip(n.edges(), names, limits, widths, strict=True)
    edges = [replace(e, id=name, speed_limit=limit, width=width) for e, name, limit, width in told]
    turns = [(names[i], names[int(j)]) for i in range(len(n)) for j in n.successors(i)]
    return build_network(edges, turns, has_elevation=False)


def slow_zones(network: Network) -> tuple[Zone, ...]:
    """Where roads that meet are all driven slowly: their outline, with the highest speed driven in it. An
    outline that a faster road enters would slow that one down: it is left out."""
    if not (known := np.isfinite(network.speed_limit)).any():
        return ()
    usual = float(np.average(network.speed_limit[known], weights=network.length[known]))
    slow = known & (network.speed_limit < SLOW * usual)
    meet = coo_matrix((slow.astype(float), (network.start, network.end)), shape=(len(network.node_ids),) * 2)
    _, group = connected_components(meet, directed=False)
    names = np.unique(group[network.start[slow]])
    found = (_zone(network, slow & (group[network.start] == name)) for name in names)
    return tuple(replace(zone, id=f"slow-{k}") for k, zone in enumerate(filter(None, found), 1))


def _zone(network: Network, mine: Mask) -> Zone | None:
    if network.length[mine].sum() < SHORT_ZONE:
        return None
    owner = np.repeat(mine, np.diff(network.first))
    points = network.points[owner, :2]
    around = np.array([[-RIM, -RIM], [-RIM, RIM], [RIM, -RIM], [RIM, RIM]])
    rim = (points[:, None] + around[None]).reshape(-1, 2)
    if (hull := ConvexHull(rim)).volume > OPEN * 2.0 * RIM * float(network.length[mine].sum()):
        return None
    zone = Zone("", rim[hull.vertices], float(np.ceil(network.speed_limit[mine].max() * 10) / 10))
    others = network.points[~owner, :2]
    near_end = np.hypot(*(others[:, None] - points[None]).transpose(2, 0, 1)).min(axis=1) < 2 * RIM
    return None if (zone.contains(*others.T) & ~near_end).any() else zone


def _result(
    site: Site, cells: Driven, table: pd.DataFrame, places: pd.DataFrame,
    proposed: list[dict[str, Any]] | None, e: Evidence,
) -> Result:  # fmt: skip
    lacking = proposed or []
    network, kinds = site.roads(), places.kind.value_counts().to_dict()
    summary = {
        "roads": len(set(network.roads)), "oneway": int((network.reverse < 0).sum()),
        "length_m": float(network.length.sum()), "nodes": len(network.node_ids), "places": len(places),
        "kinds": kinds, "zones": len(site.zones), "rows": e.rows, "rows_on_roads": e.matched,
        "proposals": lacking,
    }  # fmt: skip
    told = ": " + ", ".join(f"{n} {k}" for k, n in kinds.items()) if kinds else ""
    matched = SAID("matched", share=100.0 * e.matched / max(e.rows, 1), **summary)
    lines = [SAID("roads", **summary), matched, SAID("places", **summary, told=told)]
    lines += map(sentence, lacking[:8])
    if proposed == []:
        lines.append("the map that was given has every road that is driven, in its direction")
    if len(lacking) > 8:
        lines.append(f"and {len(lacking) - 8} more proposals in proposals.parquet")
    edges, passes = np.arange(len(network), dtype=np.int32), table["passes"].to_numpy(float)
    driven = EdgeValues("roads", edges, np.zeros(len(network)), network.length, passes, "passages")
    tables = {"roads": table}
    shapes: list[Shape] = [_traces(cells), driven]
    if lacking:
        tables["proposals"] = pd.DataFrame(lacking)
        xy, kind = np.array([(p["x"], p["y"]) for p in lacking]), tuple(p["kind"] for p in lacking)
        shapes.append(Marks("proposed change of the map", xy, kind, np.ones(len(lacking)), "critical"))
    return Result("learn", summary, tables, {"places": places}, shapes, lines)


def _traces(cells: Driven) -> Grid:
    """Metres driven on each square metre of the floor."""
    x0, y0 = float(cells.x.min()), float(cells.y.min())
    width, height = float(np.ptp(cells.x)), float(np.ptp(cells.y))
    side = max(SIDE, float(np.sqrt((width + 1.0) * (height + 1.0) / MOST_SQUARES)))
    edges = [low + side * np.arange(int(long / side) + 2) for low, long in ((y0, height), (x0, width))]
    metres, _, _ = np.histogram2d(cells.y, cells.x, edges, weights=cells.weight)
    metres[metres <= 0.0] = np.nan
    return Grid("traces", metres / side**2, x0, y0, side, "metres driven on each square metre")


def proposals(learned: Network, evidence: pd.DataFrame, known: Network) -> list[dict[str, Any]]:
    """The stretches that ``known`` has not, or for the other direction only, those with most passes first.
    ``begin`` and ``end`` are offsets on a learned edge, ``x`` and ``y`` the middle of a stretch [m]."""
    edge, there = known.stations(STEP)
    mine, offset = learned.stations(STEP)
    heading, facing = known.heading(edge, there), learned.heading(mine, offset)
    points = learned.position(mine, offset)[:, :2]
    other = np.full(len(mine), SAME)
    near = cKDTree(known.position(edge, there)[:, :2]).query_ball_point(points, NEAR)
    for i, beside in enumerate(near):
        turn = np.cos(heading[beside] - facing[i]) if beside else np.zeros(0)
        if not (turn > ALIKE).any():
            against = np.flatnonzero(turn < -ALIKE)
            other[i] = edge[beside[against[0]]] if len(against) else NONE
    found, state = [], np.minimum(other, 0)
    change = np.flatnonzero((np.diff(mine) != 0) | (np.diff(state) != 0)) + 1
    for a, b in pairwise([0, *change.tolist(), len(mine)]):
        if state[a] == SAME or offset[b - 1] - offset[a] + STEP < SHORTEST:
            continue
        row, middle = evidence.iloc[int(mine[a])], (a + b) // 2
        found.append({
            "kind": "missing road" if state[a] == NONE else "wrong one-way",
            "edge_id": learned.edge_ids[mine[a]],
            "of_map": "" if state[a] == NONE else known.edge_ids[other[middle]], "begin": float(offset[a]),
            "end": float(offset[b - 1]), "x": float(points[middle, 0]), "y": float(points[middle, 1]),
            **{name: int(row[name]) for name in ("passes", "trucks", "days")},
        })  # fmt: skip
    return sorted(found, key=lambda p: (-p["passes"], p["edge_id"], p["begin"]))


def sentence(proposal: dict[str, Any]) -> str:
    """A proposal for a person."""
    what = "one_way" if proposal["kind"] == "wrong one-way" else "missing"
    return SAID(what, **proposal, length=proposal["end"] - proposal["begin"])
