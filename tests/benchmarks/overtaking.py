"""What it costs that trucks cannot overtake: SUMO with and without overtaking, and fleetlog, on the same tasks.

    python tests/benchmarks/overtaking.py [--trucks 12 36] [--pitch 60] [--minutes 60] [--seeds 3]

A grid of 4 by 4 crossings ``pitch`` m apart, two-way roads, 3 m/s.  Every truck has three places beside roads that are its own, so
that none waits for a place, and drives a list of tasks between them, one after the other, 20 s at each place.  Half of the
rows have a sixth of the fleet that drives at half the speed.  SUMO drives the lists in three ways:

- *behind*: one lane a direction, no overtaking;
- *opposite*: one lane a direction, overtaking on the lane of those who come the other way, where it is free;
- *two lanes* a direction: whoever is faster passes.

Trucks work in bays, or on the road.  In SUMO a truck that turns into a bay, and one that comes out of it, stands on its
lane for TURN seconds; a truck that works on the road blocks its lane for all of its 20 s.  A truck of SUMO leaves a place in the
direction in which it came, one of fleetlog may turn round there: its trips are shorter, and what overtaking brings is the
difference between the columns of SUMO.  Prints rows of Markdown: tasks done an hour and seconds a trip between two places,
means over the seeds; and metres a trip, of SUMO and of fleetlog.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).parents[1] / "simulate"))

SIDE, LIMIT = 4, 3.0
SPOTS = np.linspace(0.3, 0.7, 5)  # Of places along every road, as shares of it
OWN, WORK, TURN = 3, 20.0, 6.0
"""Places of a truck, seconds at one, seconds that a lane is blocked by a truck that turns in or out."""
SLOW, SHARE = 0.5, 6  # Of the speed limit; every so many-th truck, if any
WAYS = ("behind", "opposite", "two lanes")


def lists(site, trucks: int, minutes: float, seed: int) -> list[list[int]]:
    """Of each truck the places that it goes to in turn, first where it begins; more than it can do."""
    rng = np.random.default_rng(seed)
    own = rng.permutation(len(site.places))[: trucks * OWN].reshape(trucks, OWN)
    out = []
    for mine in own:
        way = [int(mine[0])]
        for _ in range(int(4 * minutes)):
            way.append(int(rng.choice([k for k in mine if k != way[-1]])))
        out.append(way)
    return out


def places(pitch: float):
    """The site, and of each place the road and how far along it, as (road, metres)."""
    from simulated_sites import grid

    from fleetlog.core.site import Place

    roads = grid(SIDE, SIDE, pitch).roads()
    spots, at = [], []
    for k, name in enumerate(roads.edge_ids):
        if name.startswith("-"):
            continue
        a, b = roads.polyline(k)[[0, -1], :2]
        along = (b - a) / np.linalg.norm(b - a)
        for n, s in enumerate(SPOTS * pitch):
            # One on the right of the road, the next on the left.
            x, y = a + s * along + 5.0 * (1 - 2 * (n % 2)) * np.array([along[1], -along[0]])
            spots.append(Place(f"{name}.{n}", "pick", float(x), float(y)))
            at.append((name, float(s)))
    return grid(SIDE, SIDE, pitch, places=spots), at


def speeds(trucks: int, mixed: bool) -> list[float]:
    return [LIMIT * (SLOW if mixed and v % SHARE == 0 else 1.0) for v in range(trucks)]


def ours(site, ways, minutes: float, mixed: bool, folder: Path) -> tuple[float, float, float]:
    """Tasks an hour; seconds and metres a trip."""
    from simulated_sites import TRUCK

    from fleetlog.simulate import engine
    from fleetlog.simulate.dispatch import Dispatcher
    from fleetlog.simulate.tasks import Demand, Task
    from fleetlog.simulate.world import vehicle_names
    from fleetlog.store import DatasetWriter

    class InTurn(Dispatcher):
        """Every truck does its own tasks in the order of its list, not the nearest first."""

        def _due_task(self, v, now):
            return next((task for task in self._due if task.vehicle == self.names[v]), None)

    engine.Dispatcher = InTurn
    names, given = vehicle_names(len(ways)), []
    for name, way in zip(names, ways, strict=True):
        ids = [site.places[k].id for k in way[1:]]
        for source, target in zip(ids[::2], ids[1::2], strict=True):
            given.append(Task(name, source, target, 500.0, 0.0, (WORK, WORK), (0.3, 0.3)))
    kinds = [TRUCK.with_value("drive.max_speed", v) for v in speeds(len(ways), mixed)]
    settings = engine.Settings(vehicles=len(ways), duration=60.0 * minutes)
    with DatasetWriter.create(folder / "ours", "simulated", site, overwrite=True) as writer:
        summary = engine.simulate(site, kinds, writer, settings, Demand(given, endless=False))
    done = pl.read_parquet(folder / "ours" / "tasks.parquet").filter(pl.col("picked").is_not_null())
    # The first way to a load begins where the truck happened to stand.
    first = pl.col("assigned") == pl.col("assigned").min().over("vehicle_id")
    fetched = done.filter(~first).select((pl.col("picked") - pl.col("assigned")).dt.total_milliseconds())
    dropped = done.filter(pl.col("dropped").is_not_null())
    brought = dropped.select((pl.col("dropped") - pl.col("picked")).dt.total_milliseconds())
    trip = np.concatenate([fetched.to_numpy(), brought.to_numpy()]) * 1e-3 - WORK
    return len(dropped) * 60.0 / minutes, float(trip.mean()), summary.distance_m / (2.0 * len(dropped))


def program(name: str, *arguments: object) -> None:
    import sumo

    call = [str(Path(sumo.SUMO_HOME) / "bin" / name), *map(str, arguments)]
    done = subprocess.run(call, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr[-800:])


def network(site, how: str, lateral: float, folder: Path) -> Path:
    """SUMO's network of the site's roads."""
    roads, nodes, lines = site.roads(), {}, []
    for k, name in enumerate(roads.edge_ids):
        start, end = roads.polyline(k)[[0, -1], :2]
        ids = [f"n{x:.0f}_{y:.0f}" for x, y in (start, end)]
        nodes |= dict(zip(ids, (start, end), strict=True))
        lanes = 2 if how == "two lanes" else 1
        about = f'numLanes="{lanes}" width="2" speed="{LIMIT}"'
        lines.append(f'<edge id="{name}" from="{ids[0]}" to="{ids[1]}" {about}/>')
    points = (f'<node id="{n}" x="{x}" y="{y}" type="right_before_left"/>' for n, (x, y) in nodes.items())
    (folder / "nodes.xml").write_text(f"<nodes>{''.join(points)}</nodes>")
    (folder / "edges.xml").write_text(f"<edges>{''.join(lines)}</edges>")
    files = ["-n", folder / "nodes.xml", "-e", folder / "edges.xml", "-o", folder / "net.xml"]
    more = ["--opposites.guess", "true"] if how == "opposite" else []
    program("netconvert", *files, "--no-turnarounds", "--junctions.limit-turn-speed", lateral, *more)
    return folder / "net.xml"


def onward(roads, start: int, goals: list[int]) -> list[int]:
    """The shortest way from one edge to one of some others, with both."""
    seen, ways = {start}, [[start]]
    while True:
        way = ways.pop(0)
        for k in roads.successors(way[-1]):
            if k in goals:
                return [*way, k]
            if k not in seen and roads.reverse[way[-1]] != k:
                seen.add(k)
                ways.append([*way, k])


def sumo_drives(
    site, at, ways, minutes: float, mixed: bool, how: str, on_road: bool, seed: int, folder: Path
) -> tuple[float, float, float]:
    """Tasks an hour; seconds and metres a trip."""
    from simulated_sites import TRUCK

    from fleetlog.simulate.junctions import GAP

    drive, roads, text = TRUCK.drive, site.roads(), []
    net = network(site, how, drive.max_lateral_acceleration, folder)
    for v, speed in enumerate(speeds(len(ways), mixed)):
        about = f'length="{TRUCK.chassis.length}" width="{TRUCK.chassis.width}" minGap="{GAP}" sigma="0"'
        pace = f'accel="{drive.max_acceleration}" decel="{drive.max_deceleration}" maxSpeed="{speed}"'
        text.append(f'<vType id="k{v}" speedDev="0" {about} {pace}/>')
    reached: list[list[float]] = [[] for _ in ways]  # Metres from the start to each place
    for v, way in enumerate(ways):
        edges, stops = [roads.index[at[way[0]][0]]], []
        for place in way:
            road, s = at[place]
            ends = [roads.index[road], roads.index[f"-{road}"]]
            ahead = onward(roads, edges[-1], ends) if stops else edges[-1:]
            edges += ahead[1:]
            where = s if edges[-1] == ends[0] else float(roads.length[ends[0]]) - s
            reached[v].append(float(roads.length[edges[:-1]].sum()) + where)
            stops += stop(roads.edge_ids[edges[-1]], where, on_road)
        names = " ".join(roads.edge_ids[k] for k in edges)
        text.append(
            f'<vehicle id="{v}" type="k{v}" depart="{v}"><route edges="{names}"/>{"".join(stops)}</vehicle>'
        )
    (folder / "routes.xml").write_text(f"<routes>{''.join(text)}</routes>")
    program(
        "sumo", "-n", net, "-r", folder / "routes.xml", "--step-length", 0.2, "--end", 60.0 * minutes, "--seed", seed,
        "--time-to-teleport", -1, "--collision.action", "none", "--stop-output", folder / "stops.csv",
        "--no-step-log", "--no-warnings",
    )  # fmt: skip
    table = pl.read_csv(folder / "stops.csv", separator=";", infer_schema_length=10000)
    done, trips, metres = 0, [], 0.0
    for v in range(len(ways)):
        mine = table.filter(pl.col("stopinfo_id") == v).sort("stopinfo_started")
        begin, end = mine["stopinfo_started"].to_numpy(), mine["stopinfo_ended"].to_numpy()
        works = np.abs(end - begin - WORK) < 1.0
        begin, end = begin[works], end[works]
        # First where it begins, then to a load, to where that goes, to a load ...
        done += (len(end) - 1) // 2
        trips += (begin[1:] - end[:-1]).tolist()[: len(end) - 1]
        metres += reached[v][len(end) - 1] - reached[v][0]
    return done * 60.0 / minutes, float(np.mean(trips)), metres / len(trips)


def stop(lane: str, at: float, on_road: bool) -> list[str]:
    """A place: worked at on the road, or beside it, with the lane blocked before and after."""
    parts = [(WORK, False)] if on_road else [(TURN, False), (WORK, True), (TURN, False)]
    return [
        f'<stop lane="{lane}_0" startPos="{at - 2.0}" endPos="{at}" duration="{s}" parking="{str(p).lower()}"/>'
        for s, p in parts
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trucks", type=int, nargs="+", default=[12, 36])
    parser.add_argument("--pitch", type=float, default=60.0)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    site, at = places(args.pitch)
    print(f"| trucks | slow | work | {' | '.join(WAYS)} | fleetlog | m a trip |")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for trucks, mixed, on_road in itertools.product(args.trucks, (False, True), (False, True)):
            rows = []
            for seed in range(args.seeds):
                plan = lists(site, trucks, args.minutes, seed)
                same = site, at, plan, args.minutes, mixed
                rows.append([sumo_drives(*same, how, on_road, seed, folder) for how in WAYS])
                if not on_road:
                    rows[-1].append(ours(site, plan, args.minutes, mixed, folder))
            found = np.mean(rows, axis=0)
            cells = [f"{tasks:,.0f}, {trip:.1f} s" for tasks, trip, _ in found] + ["-"] * on_road
            metres = ", ".join(f"{m:.0f}" for m in (found[0, 2], *found[len(WAYS) :, 2]))
            about = f"{trucks} | {trucks // SHARE if mixed else 0} | {'road' if on_road else 'bay'}"
            print(f"| {about} | {' | '.join(cells)} | {metres} |", flush=True)


if __name__ == "__main__":
    main()
