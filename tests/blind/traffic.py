"""Recordings of trucks in one another's way: motion by SUMO, forces, loggers and keys as of the recorder.

    python traffic.py CASE FOLDER        CASE as in cases.py, site=grid; vehicles=4 to 20

The key tells the share of travel time that is lost to other trucks: every truck is driven once more alone.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from cases import Case
from effects import Effect
from key import key_of
from loggers import LOGGERS, for_sensor_effects
from observe import Seen, observe
from power import HZ, Motion
from recorder import write_log
from scipy.ndimage import gaussian_filter1d
from shifts import PIECE, Legs, lifting
from sites import Site
from streets import BAY, IMPERFECT, STEP, Mission, grid, mission, run, write_missions, write_network
from trucks import truck_type
from world import World, conceal

AS_DRIVEN = {"lateral_acceleration": 1.77, "acceleration": 1.0 - IMPERFECT / 2.0}
"""What a truck file says that fits its trucks, over SUMO's number.

Lateral acceleration as measured: a map has no lanes, so a model gives all corners the radius of the truck file.  Imperfect
drivers gather speed more slowly than they could, by half of their imperfection on average.
"""
SIZES = ((3, 3), (4, 3), (4, 4), (5, 4), (6, 5))


@dataclass
class Track:
    """One truck in one run: arrays at every step of SUMO, and begin and end of its stops [s]."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    v: np.ndarray
    road: np.ndarray
    started: np.ndarray
    ended: np.ndarray

    def trips(self) -> list[np.ndarray]:
        """Rows of every finished trip."""
        begins = np.concatenate([[self.t[0]], self.ended])
        return [
            np.flatnonzero((self.t > a) & (self.t <= b)) for a, b in zip(begins, self.started, strict=False)
        ]

    def pieces(self) -> list[np.ndarray]:
        """Seconds for every twelve metres of every finished trip."""
        out = []
        for rows in self.trips():
            s = np.cumsum(self.v[rows]) * STEP + np.arange(len(rows)) * 1e-9
            marks = np.arange(0.0, s[-1] if len(s) else 0.0, PIECE)
            out.append(np.diff(np.interp(marks, s, self.t[rows])))
        return out

    def by_road(self, trips: int) -> dict[int, float]:
        """Seconds on every road in so many trips."""
        rows = np.concatenate(self.trips()[:trips])
        roads, count = np.unique(self.road[rows], return_counts=True)
        return dict(zip(map(int, roads), map(float, count * STEP), strict=True))


@dataclass
class Streets:
    """A site with its trucks, runs of which are made in a folder."""

    world: World
    missions: list[Mission]
    folder: Path

    def drive(
        self, who: Sequence[int], effects: Sequence[Effect], sigma: float, hours: float
    ) -> dict[int, Track]:
        """Let some of the trucks drive their missions at once."""
        w = self.world
        network = write_network(w.site, w.truck, effects, self.folder)
        routes = self.folder / "routes.xml"
        write_missions([(k, self.missions[k]) for k in who], w.site, w.truck, effects, routes, sigma)
        laden = next((e.parameters["factor"] for e in effects if e.term == "laden_speed"), None)
        slow = {f"T{k + 1}": _by_load(self.missions[k], laden) for k in who} if laden else None
        tracks, stops = run(network, routes, hours, w.case.seed % 10**6, slow)
        return {k: _track(tracks, stops, f"T{k + 1}") for k in who}


def _by_load(m: Mission, laden: float) -> list[float]:
    return [laden if m.load(k) > 0 else 1.0 for k in range(len(m.stops) + 1)]


def _track(tracks: pl.DataFrame, stops: pl.DataFrame, name: str) -> Track:
    mine = tracks.filter(pl.col("vehicle_id") == name)
    bays = stops.filter((pl.col("stopinfo_id") == name) & (pl.col("stopinfo_parking") == 1))
    t, x, y, angle, v = (mine[c].to_numpy().copy() for c in (
        "timestep_time", "vehicle_x", "vehicle_y", "vehicle_angle", "vehicle_speed"))  # fmt: skip
    # Lanes within a junction count as the road before it.
    lane = (
        mine["vehicle_lane"]
        .str.extract(r"^-?r(\d+)_")
        .cast(pl.Int64)
        .fill_null(strategy="forward")
        .to_numpy()
    )
    started, ended = (bays[f"stopinfo_{side}"].to_numpy() for side in ("started", "ended"))
    # SUMO draws parked trucks beside the road; here they stay on it.
    for a, b in zip(started, ended, strict=True):
        parked = (t >= a) & (t <= b)
        last = max(int(np.searchsorted(t, a)) - 1, 0)
        x[parked], y[parked], angle[parked], v[parked] = x[last], y[last], angle[last], 0.0
    heading = np.unwrap(np.pi / 2.0 - np.deg2rad(angle))
    return Track(t, x, y, heading, v, lane, started, ended)


def motion_of(w: World, track: Track, m: Mission, vehicle: int, rng: np.random.Generator) -> Motion:
    """The motion at every tick, smoothed over the steps of SUMO; forks go up and down in the bays."""
    t = np.arange(track.t[0], track.t[-1], 1.0 / HZ)
    still = np.interp(t, track.t, (track.v > 0.02).astype(float)) == 0.0
    v = gaussian_filter1d(np.interp(t, track.t, track.v), 0.3 * HZ) * ~still
    x, y, heading = (
        gaussian_filter1d(np.interp(t, track.t, a), 0.2 * HZ) for a in (track.x, track.y, track.heading)
    )
    heading = gaussian_filter1d(heading, 0.4 * HZ)
    bend = np.where(v > 0.4, np.gradient(heading) * HZ / np.maximum(v, 0.4), 0.0)
    road = track.road[np.clip(np.searchsorted(track.t, t), 0, len(track.t) - 1)]
    trip = np.searchsorted(track.ended, t, side="right")
    loads = np.array([m.load(k) for k in range(len(m.stops) + 1)])
    wrong = np.maximum(1.0 + 0.03 * rng.normal(size=len(loads)), 0.0)
    rate = np.zeros(len(t))
    for a, b in zip(track.started, track.ended, strict=True):
        first = int((a - t[0] + 1.0) * HZ)
        moves = lifting(int((b - a - 2.0) * HZ), rng)[: len(t) - first]
        rate[first : first + len(moves)] = moves
    rate *= v == 0
    zero = np.zeros(len(t))
    return Motion(
        t=t + 5.0 * vehicle / HZ, v=v, x=x, y=y, heading=heading, bend=np.clip(bend, -0.5, 0.5), road=road,
        slope=zero, load=loads[trip], weighed=(loads * wrong)[trip], lift=rate,
        height=np.maximum(np.cumsum(rate) / HZ, 0.0), temperature=2.0 + 2.6 * t / 3600.0, charge=zero,
    )  # fmt: skip


def record(case: Case | str, folder: Path) -> dict[str, Any]:
    """Write a recording of traffic and its key; see ``recorder.record``."""
    case = Case.parse(case) if isinstance(case, str) else case
    w = streets_world(case)
    rng = np.random.default_rng([case.seed, 10])
    missions = [mission(w.site, w.truck, case.hours, rng) for _ in range(case.vehicles)]
    with tempfile.TemporaryDirectory() as scratch:
        streets = Streets(w, missions, Path(scratch))
        together = streets.drive(range(case.vehicles), w.effects, IMPERFECT, case.hours)
        lost, legs = alone(streets, together)
    tables: list[pl.DataFrame] = []
    seen: list[Seen] = []
    for k, track in together.items():
        noise = np.random.default_rng([case.seed, 9, k])
        own = w.truck.own(np.random.default_rng([case.seed, 7, k]))
        table, rows = observe(w, motion_of(w, track, missions[k], k, noise), own, k, noise)
        tables.append(table)
        seen.append(rows)
    log = pl.concat(tables).sort("timestamp", "vehicle_id", maintain_order=True)
    key = key_of(w, seen, legs, log.height) | {"congestion": lost}
    key["allowed"].append("congestion")
    for e in key["effects"]:
        e["parameters"] = {k: AS_DRIVEN.get(k, 1.0) * v for k, v in e["parameters"].items()}
    folder.mkdir(parents=True, exist_ok=True)
    w.site.write(folder)
    driven = {
        "lateral": AS_DRIVEN["lateral_acceleration"] * w.file.lateral,
        "acceleration": AS_DRIVEN["acceleration"] * w.file.acceleration,
    }
    replace(w.file, **driven).write(folder / "truck.toml")
    write_log(log, folder / "recorded.csv.gz")
    (folder / "key.json").write_text(json.dumps(key, indent=1))
    return key


def streets_world(case: Case) -> World:
    """A grid that is the denser the more trucks there are on it."""
    rng = np.random.default_rng(case.seed)
    size = SIZES[int(rng.integers(len(SIZES)))]
    site = Site("grid", grid(rng, *size))
    while site.dead_ends():
        site = Site("grid", grid(rng, *size))
    truck = replace(truck_type(rng), drag_area=6.0 if "wind" in case.terms else 0.0)
    effects = [_reachable(e) for e in conceal(case, site, truck)]
    return World(case, site, truck, truck, effects, for_sensor_effects(LOGGERS[case.logger], effects))


def _reachable(e: Effect) -> Effect:
    """Waiting places lie before the bays, which trucks turn into."""
    return replace(e, parameters=e.parameters | {"at": BAY - 0.15}) if e.term == "waiting" else e


def alone(streets: Streets, together: dict[int, Track]) -> tuple[dict[str, Any], list[Legs]]:
    """What others cost: every truck is driven once more alone, with and without the effects on speed."""
    w, hours = streets.world, streets.world.case.hours * 1.02
    on_speed = [e for e in w.effects if e.channel == "speed"]
    choices = {"": on_speed} | ({"*": [], on_speed[0].term: on_speed[1:]} if on_speed else {})
    legs, lost, whole = [], 0.0, 0.0
    roads: dict[int, float] = {}
    for k, track in together.items():
        runs = {name: streets.drive([k], effects, IMPERFECT, hours)[k] for name, effects in choices.items()}
        n = min(len(one.trips()) for one in (track, *runs.values()))
        legs.append(Legs(k, track.pieces()[:n], {name: one.pieces()[:n] for name, one in runs.items()}))
        with_others, by_itself = track.by_road(n), runs[""].by_road(n)
        for road, seconds in with_others.items():
            roads[road] = roads.get(road, 0.0) + seconds - by_itself.get(road, 0.0)
        lost += sum(with_others.values()) - sum(by_itself.values())
        whole += sum(with_others.values())
    worst = sorted(roads, key=lambda r: -roads[r])[:5]
    return {
        "share": lost / whole,
        "seconds": lost,
        "roads": {w.site.names([r])[0]: roads[r] for r in worst},
        "standing": float(np.mean([_standing(t) for t in together.values()])),
    }, legs


def _standing(track: Track) -> float:
    """Share of the time between stops at which a truck stands."""
    rows = np.concatenate(track.trips())
    return float((track.v[rows] < 0.05).mean())


if __name__ == "__main__":
    record(sys.argv[1], Path(sys.argv[2]))
