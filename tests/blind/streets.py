"""Trucks among each other on a grid of roads: the network, the missions and the runs of SUMO.

Car following, right of way and imperfect drivers are SUMO's; trips end in bays beside the road.  Nothing of
fleetlog is used here.
"""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from effects import Effect
from layouts import Layout
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from sites import Site
from trucks import Truck

STEP = 0.2
"""Seconds a step of the simulation."""
BAY = 0.6
"""Share of a road's length at which its bay is."""
TIGHTEST = 1.33
"""Measured: lateral acceleration where SUMO's turns are tightest, over the one that their speed is set by."""
IMPERFECT = 0.25
"""SUMO's driver imperfection (sigma)."""


@dataclass
class Mission:
    """A truck's day: directed roads in order; of each stop its place there, seconds and load after."""

    way: list[tuple[int, int]]
    stops: list[int]
    seconds: list[float]
    loads: list[float]
    pace: float

    def load(self, trip: int) -> float:
        """Load on the way to stop ``trip``."""
        return self.loads[trip - 1] if trip else 0.0


def grid(rng: np.random.Generator, nx: int, ny: int) -> Layout:
    """Two-way roads between junctions that are not quite in line."""
    at = np.array([(x, y) for y in range(ny) for x in range(nx)], float)
    xy = at * rng.uniform(40.0, 55.0, 2) + rng.uniform(-6.0, 6.0, (nx * ny, 2))
    ends = [(k, k + 1) for k in range(nx * ny) if k % nx < nx - 1] + [
        (k, k + nx) for k in range(nx * (ny - 1))
    ]
    m = len(ends)
    limit = rng.choice([2.5, 3.5, 4.5], m, p=[0.15, 0.5, 0.35])
    return Layout(xy, np.array(ends), np.zeros(m), limit, np.zeros(m, bool))


def mission(site: Site, truck: Truck, hours: float, rng: np.random.Generator) -> Mission:
    """Draw trips from bay to bay until the day is full; no truck turns back on a road."""
    state = int(rng.integers(2 * site.roads))
    out = Mission([_road(site, state)], [], [], [], float(1.0 + 0.015 * rng.normal()))
    planned, loaded = 0.0, False
    while planned < 1.15 * hours * 3600.0:
        goal = int(rng.integers(2 * site.roads))
        ahead = _onward(site, state, goal, rng)
        if len(ahead) < 3:
            continue
        out.way += [_road(site, k) for k in ahead[1:]]
        loaded = not loaded if rng.random() < 0.9 else loaded
        out.stops.append(len(out.way) - 1)
        out.seconds.append(float(rng.uniform(20.0, 60.0)))
        out.loads.append(float(rng.uniform(300, 2400)) if loaded else 0.0)
        planned += out.seconds[-1] + sum(site.length[k % site.roads] for k in ahead[1:]) / 3.5
        state = goal
    return out


def _road(site: Site, state: int) -> tuple[int, int]:
    return state % site.roads, 1 if state < site.roads else -1


def _onward(site: Site, start: int, goal: int, rng: np.random.Generator) -> list[int]:
    """Directed roads from one to another, with those; empty where there is no way."""
    begin, _, first, second = site.turns
    cost = np.tile(site.length * rng.uniform(0.7, 1.6, site.roads), 2)
    graph = csr_matrix((cost[second], (first, second)), shape=(len(begin), len(begin)))
    apart, came = dijkstra(graph, indices=start, return_predecessors=True)
    if start == goal or not np.isfinite(apart[goal]):
        return []
    out = [goal]
    while out[-1] != start:
        out.append(int(came[out[-1]]))
    return out[::-1]


def binary(name: str) -> str:
    """Path of one of SUMO's programs."""
    import sumo

    return str(Path(sumo.SUMO_HOME) / "bin" / name)


def edge(road: int, sense: int) -> str:
    """SUMO's name of a directed road."""
    return f"{'' if sense > 0 else '-'}r{road:02d}"


def write_network(site: Site, truck: Truck, effects: Sequence[Effect], folder: Path) -> Path:
    """Write SUMO's network of the site with what effects make of its speeds."""
    limit, lateral = site.layout.limit.copy(), truck.lateral
    for e in effects:
        if e.term == "speed_zone":
            limit[list(e.roads)] *= e.parameters["factor"]
        if e.term == "cornering_speed":
            lateral = e.parameters["lateral_acceleration"]
    nodes = [
        f'<node id="j{k}" x="{x:.2f}" y="{y:.2f}" type="right_before_left"/>'
        for k, (x, y) in enumerate(site.layout.xy)
    ]
    lines = []
    for k, (a, b) in enumerate(site.layout.ends):
        for sense, start, end in ((1, a, b), (-1, b, a)):
            about = f'numLanes="1" width="2.4" speed="{limit[k]:.4f}"'
            lines.append(f'<edge id="{edge(k, sense)}" from="j{start}" to="j{end}" {about}/>')
    out = folder / "net.xml"
    (folder / "nodes.xml").write_text(f"<nodes>{''.join(nodes)}</nodes>")
    (folder / "edges.xml").write_text(f"<edges>{''.join(lines)}</edges>")
    files = ["-n", folder / "nodes.xml", "-e", folder / "edges.xml", "-o", out]
    options = [
        "--no-turnarounds",
        "--offset.disable-normalization",
        "--junctions.limit-turn-speed",
        f"{lateral / TIGHTEST:.4f}",
    ]
    _quietly([binary("netconvert"), *map(str, files), *options])
    return out


def write_missions(
    missions: Iterable[tuple[int, Mission]],
    site: Site,
    truck: Truck,
    effects: Sequence[Effect],
    file: Path,
    sigma: float,
) -> None:
    """Write SUMO's routes; the bays are off the road, waiting places on it."""
    up = next(
        (e.parameters["acceleration"] for e in effects if e.term == "acceleration_limit"), truck.acceleration
    )
    about = f'length="2.6" minGap="1.2" maxSpeed="5" tau="1.2" sigma="{sigma}"'
    kinds, trucks = [], []
    for number, m in missions:
        pace = f'accel="{up:.4f}" decel="{truck.deceleration}" emergencyDecel="4" '
        pace += f'speedFactor="{truck.speed_factor * m.pace:.4f}"'
        kinds.append(f'<vType id="k{number}" speedDev="0" {about} {pace}/>')
        names = " ".join(edge(*leg) for leg in m.way)
        stops = "".join(_stops(m, site, effects))
        place = f'departPos="{BAY * site.length[m.way[0][0]]:.1f}" departSpeed="0"'
        trucks.append(
            f'<vehicle id="T{number + 1}" type="k{number}" depart="{number * 2.0}" {place}>'
            f'<route edges="{names}"/>{stops}</vehicle>'
        )
    file.write_text(f"<routes>{''.join(kinds)}{''.join(trucks)}</routes>")


def _stops(m: Mission, site: Site, effects: Sequence[Effect]) -> Iterable[str]:
    waits = [e for e in effects if e.term == "waiting"]
    bays = dict(zip(m.stops, m.seconds, strict=True))
    for k, (road, sense) in enumerate(m.way):
        for e in waits:
            if k and (road, sense) == (e.roads[0], e.sense) and e.parameters["at"] < BAY:
                at, seconds = (
                    e.parameters["at"] * site.length[road],
                    e.parameters["seconds"] * (0.7 + 0.6 * (k * 0.618 % 1.0)),
                )
                where = f'edge="{edge(road, sense)}" endPos="{at:.1f}" friendlyPos="true"'
                yield f'<stop {where} duration="{seconds:.1f}"/>'
        if k in bays:
            at = BAY * site.length[road]
            where = f'edge="{edge(road, sense)}" endPos="{at:.1f}" friendlyPos="true"'
            yield f'<stop {where} duration="{bays[k]:.1f}" parking="true"/>'


def run(
    network: Path, routes: Path, hours: float, seed: int, slow: dict[str, list[float]] | None = None
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Tracks and stops of all trucks; ``slow``: share of its speed that a truck drives on each trip."""
    folder = routes.parent
    tracks, stops = folder / "tracks.csv", folder / "stops.csv"
    call = [
        binary("sumo"),
        "-n",
        str(network),
        "-r",
        str(routes),
        "--step-length",
        str(STEP),
        "--end",
        str(hours * 3600.0),
    ]
    call += [
        "--step-method.ballistic",
        "--seed",
        str(seed),
        "--time-to-teleport",
        "-1",
        "--collision.action",
        "none",
    ]
    call += ["--fcd-output", str(tracks), "--stop-output", str(stops), "--no-step-log", "--no-warnings"]
    call += ["--fcd-output.attributes", "x,y,angle,speed,lane", "--precision", "4"]
    if slow:
        _step_by_step(call, hours, slow)
    else:
        _quietly(call)
    read = {"separator": ";", "infer_schema_length": 10000}
    return pl.read_csv(tracks, **read), pl.read_csv(stops, **read)  # type: ignore[arg-type]


def _step_by_step(call: list[str], hours: float, slow: dict[str, list[float]]) -> None:
    """Drive SUMO by hand, as trucks change their speed with their load."""
    import sumo

    sys.path.append(str(Path(sumo.SUMO_HOME) / "tools"))
    import traci

    with redirect_stdout(io.StringIO()):
        traci.start(call, stdout=subprocess.DEVNULL)
    trips = dict.fromkeys(slow, 0)
    usual: dict[str, float] = {}
    for _ in range(int(hours * 3600.0 / STEP) - 1):
        traci.simulationStep()
        for name in traci.simulation.getParkingEndingVehiclesIDList():
            trips[name] += 1
            usual.setdefault(name, traci.vehicle.getSpeedFactor(name))
            traci.vehicle.setSpeedFactor(name, usual[name] * slow[name][trips[name]])
    traci.close()


def _quietly(call: list[str]) -> None:
    done = subprocess.run(call, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-800:])
