"""Map matching beside its peers: a 10 m aisle grid with known truth, one process, CPU seconds.

    python tests/benchmarks/matching.py [--rows 100000] [--no-peers]

Peers (pip install fastmm leuvenmapmatching mappymatch) get the same positions, the true noise and the settings that served them best of those
tried; the slow ones get the first rows only.  Ours is told nothing: it estimates its parameters within the time given.
Accuracy is the share of rows on the right directed edge.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "matching"))
from worlds import aisle_grid, drive

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads.matching import MatchParameters, match

Matcher = Callable[[Trajectory, Network, float], tuple[float, np.ndarray]]


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


def fleetlog(track: Trajectory, network: Network, noise: float) -> tuple[float, np.ndarray]:
    seconds, found = timed(lambda: match(track, network))
    return seconds, found.edge


def fleetlog_told(track: Trajectory, network: Network, noise: float) -> tuple[float, np.ndarray]:
    """With the parameters estimated before the clock starts, as for the second day of a truck."""
    known: MatchParameters = match(track, network).parameters
    seconds, found = timed(lambda: match(track, network, known))
    return seconds, found.edge


def fastmm_with(reading: bool) -> Matcher:
    import fastmm

    kept: dict[int, Any] = {}

    def run(track: Trajectory, network: Network, noise: float) -> tuple[float, np.ndarray]:
        if id(network) not in kept:
            roads = fastmm.Network()
            for i in range(len(network)):
                ends = [tuple(p) for p in network.polyline(i)[:, :2]]
                roads.add_edge(i, int(network.start[i]), int(network.end[i]), ends)
            roads.finalize()
            matcher = fastmm.FastMapMatch(
                roads,
                fastmm.TransitionMode.SHORTEST,
                max_distance_between_candidates=60.0,
                cache_dir=Path(tempfile.gettempdir()) / "ubodt",
            )
            kept[id(network)] = (roads, matcher)  # the matcher keeps a bare pointer to the roads
        matcher = kept[id(network)][1]
        points = fastmm.Trajectory.from_xy_tuples(
            list(zip(track.floats("x").tolist(), track.floats("y").tolist(), strict=True))
        )
        radius = max(4.0, 3.0 * noise)

        def work() -> Any:
            result = matcher.match(
                points, max_candidates=8 if noise < 1.0 else 16, candidate_search_radius=radius, gps_error=4.0 * noise,
                reverse_tolerance=6.0 * noise,
            )  # fmt: skip
            return fastmm_edges(result, len(track)) if reading else result

        seconds, out = timed(work)
        return seconds, out if reading else fastmm_edges(out, len(track))

    return run


def fastmm_edges(result: Any, n: int) -> np.ndarray:
    edge = np.full(n, -1)
    for part in result.subtrajectories:
        for k, segment in enumerate(part.segments):
            edge[part.start_index + k] = segment.edges[0].edge_id
            edge[part.start_index + k + 1] = segment.edges[-1].edge_id
    return edge


def leuven() -> Matcher:
    from leuvenmapmatching.map.inmem import InMemMap
    from leuvenmapmatching.matcher.distance import DistanceMatcher

    def run(track: Trajectory, network: Network, noise: float) -> tuple[float, np.ndarray]:
        roads = InMemMap("grid", use_latlon=False, use_rtree=True, index_edges=True)
        for i, (x, y, _) in enumerate(network.node_points):
            roads.add_node(i, (float(x), float(y)))
        for a, b in zip(network.start.tolist(), network.end.tolist(), strict=True):
            roads.add_edge(a, b)
        by_ends = {
            (int(a), int(b)): i for i, (a, b) in enumerate(zip(network.start, network.end, strict=True))
        }
        matcher = DistanceMatcher(
            roads, obs_noise=max(noise, 0.5), max_dist=max(8.0, 5 * noise), max_dist_init=max(8.0, 5 * noise), min_prob_norm=1e-9,
            non_emitting_states=False, max_lattice_width=8,
        )  # fmt: skip
        points = list(zip(track.floats("x").tolist(), track.floats("y").tolist(), strict=True))
        seconds, _ = timed(lambda: matcher.match(points))
        edge = np.full(len(points), -1)
        for m in matcher.lattice_best:
            edge[m.obs] = by_ends.get((m.edge_m.l1, m.edge_m.l2), -1)
        return seconds, edge

    return run


def mappymatch() -> Matcher:
    import geopandas as gpd
    import networkx as nx
    from mappymatch.constructs.trace import Trace
    from mappymatch.maps.nx.nx_map import NxMap
    from mappymatch.matchers.lcss.lcss import LCSSMatcher
    from pyproj import CRS
    from shapely.geometry import LineString

    crs = CRS("EPSG:32632")
    far = np.array([500_000.0, 5_500_000.0])

    def run(track: Trajectory, network: Network, noise: float) -> tuple[float, np.ndarray]:
        graph = nx.MultiDiGraph()
        graph.graph["crs"] = crs
        ends = {}
        for i in range(len(network)):
            a, b = int(network.start[i]), int(network.end[i])
            ends[(a, b)] = i
            length = float(network.length[i])
            graph.add_edge(
                a, b, key=0, geometry=LineString(network.polyline(i)[:, :2] + far), kilometers=length / 1000, travel_time=length,
                minutes=length / 150,
            )  # fmt: skip
        matcher = LCSSMatcher(NxMap(graph), distance_epsilon=max(3.0, 4.0 * noise), distance_threshold=1000.0)
        points = gpd.points_from_xy(track.floats("x") + far[0], track.floats("y") + far[1])
        trace = Trace(gpd.GeoDataFrame(geometry=points, crs=crs))
        seconds, result = timed(lambda: matcher.match_trace(trace))
        edge = [
            ends.get((m.road.road_id.start, m.road.road_id.end), -1) if m.road is not None else -1
            for m in result.matches
        ]
        return seconds, np.array(edge)

    return run


def peers() -> list[tuple[str, Matcher, int]]:
    """Name, matcher and most rows of every peer that is installed."""
    out: list[tuple[str, Matcher, int]] = []
    wanted = (
        ("fastmm, match() alone", lambda: fastmm_with(False), 1 << 40),
        ("fastmm, edges read", lambda: fastmm_with(True), 1 << 40),
        ("leuvenmapmatching", leuven, 2000),
        ("mappymatch", mappymatch, 2000),
    )
    for name, make, most in wanted:
        try:
            out.append((name, make(), most))
        except ImportError as error:
            print(f"{name}: not measured, {error}")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--no-peers", action="store_true")
    options = parser.parse_args()
    network = aisle_grid()
    matchers: list[tuple[str, Matcher, int]] = [
        ("fleetlog", fleetlog, 1 << 40), ("fleetlog, parameters given", fleetlog_told, 1 << 40), *([] if options.no_peers else peers())
    ]  # fmt: skip
    match(drive(network, 2000, 1.0, 0.5, 99)[0], network)  # compile
    print(f"{'':28}" + "".join(f"{f'{rate:g} Hz, sigma {noise:g} m':>26}" for rate, noise in CASES))
    tracks = [drive(network, options.rows, rate, noise, 1) for rate, noise in CASES]
    for name, matcher, most in matchers:
        cells = []
        for (_, noise), (track, truth, _) in zip(CASES, tracks, strict=True):
            rows = min(most, len(track))
            try:
                runs = [matcher(track[:rows], network, noise) for _ in range(3 if rows > 5000 else 1)]
            except Exception as error:  # a peer that fails is a row of the table, not the end of it
                cells.append(type(error).__name__)
                continue
            seconds = float(np.median([s for s, _ in runs]))
            right = float((runs[0][1] == truth[:rows]).mean())
            cells.append(f"{right:.3f} {rows / seconds:>12,.0f}/s")
        print(f"{name:28}" + "".join(f"{c:>26}" for c in cells), flush=True)


CASES = ((10.0, 0.5), (10.0, 2.0), (1.0, 0.5), (1.0, 2.0))

if __name__ == "__main__":
    main()
