"""Throughput over density against PIBT (Okumura et al., Artificial Intelligence 310, 2022), on one grid.

    python tests/benchmarks/density_pibt.py [--crossings 4] [--minutes 20] [--trucks 20,60,120] [--plot FILE]
    python tests/benchmarks/density_pibt.py --hours 100

The roads have two lanes.  PIBT sees them as cells as long as a truck and the gap before it, two side by side, in
which an agent goes to any neighbouring free cell in the time that a truck at the speed limit needs for one.
It has no acceleration, no turning circle, no footprint across cells and no side of the road to keep to.  Tasks
are endless on both sides: to a random place, stand beside the road, to another, stand.  The truck of ``sharp`` is
made comparable: it gathers and loses speed within a cell and turns on the spot as far as roads allow; the time
of its way into a bay and out of it is part of the time that agents stand.

With --hours it counts deadlocks of plain trucks up to half of the cells full, and says when one is not broken.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "simulate"))
from simulated_sites import TRUCK, grid

from fleetlog.simulate.dispatch import spur_times
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.tasks import ENGAGE, Demand, random_visits
from fleetlog.simulate.world import build_world
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.events import read_table

PITCH, LIMIT, CELL = 60.0, 3.0, 4.0
"""Between crossings [m], speed limit [m/s], length of a truck with its gap [m]."""
WARM_UP = 1.0 / 3.0
"""Of the time, before tasks are counted: all begin beside the road."""
SHARP = replace(
    TRUCK,
    drive=replace(
        TRUCK.drive, max_acceleration=3.0, max_deceleration=3.0, max_lateral_acceleration=6.0, max_power=2e5
    ),
)


class Agents:
    """Lifelong PIBT: every step the agents in order of priority choose cells; who is pushed aside inherits."""

    def __init__(self, crossings: int, agents: int, stand: int, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        road = round(PITCH / CELL)
        size = (crossings - 1) * road + 2
        on = np.arange(size) % road < 2
        free = on[:, None] | on[None, :]
        number = np.full((size + 2, size + 2), -1)
        number[1:-1, 1:-1][free] = np.arange(free.sum())
        at = np.argwhere(number >= 0)
        around = [number[at[:, 0] + dx, at[:, 1] + dy] for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        self.near = [[c for c in row if c >= 0] for row in np.column_stack(around).tolist()]
        self.cells, self.stand = len(at), stand
        self._distance: dict[int, np.ndarray] = {}
        self.where = self.rng.permutation(self.cells)[:agents].tolist()
        self.goal = self.rng.integers(self.cells, size=agents).tolist()
        self.priority = self.rng.random(agents)
        self.away, self._on = np.zeros(agents, int), [True] * agents
        self.arrivals = 0

    def distance(self, goal: int) -> np.ndarray:
        """Steps from every cell to a goal."""
        if goal not in self._distance:
            out, front = np.full(self.cells, self.cells), [goal]
            out[goal] = 0
            while front:
                ahead = {n for c in front for n in self.near[c] if out[n] == self.cells}
                for n in ahead:
                    out[n] = out[front[0]] + 1
                front = list(ahead)
            self._distance[goal] = out
        return self._distance[goal]

    def step(self) -> None:
        """Everyone goes on by a cell at most; who is at its goal leaves the road to stand beside it."""
        self.away = np.maximum(self.away - 1, 0)
        taken = {c for v, c in enumerate(self.where) if self._on[v]}
        for v in np.argsort(-self.priority).tolist():
            if not self._on[v] and self.away[v] == 0 and self.where[v] not in taken:
                self._on[v] = True
                taken.add(self.where[v])
        self._now = {self.where[v]: v for v in range(len(self.where)) if self._on[v]}
        self._next: dict[int, int] = {}
        self._chosen: dict[int, int] = {}
        for v in np.argsort(-self.priority).tolist():
            if self._on[v] and v not in self._chosen:
                self._choose(v, -1)
        for v, cell in self._chosen.items():
            self.where[v] = cell
            self.priority[v] += 1.0
            if cell == self.goal[v]:
                self._on[v], self.away[v] = False, self.stand
                self.arrivals += 1
                self.priority[v] %= 1.0
                self.goal[v] = int(self.rng.integers(self.cells))

    def _choose(self, v: int, pusher: int) -> bool:
        here, far = self.where[v], self.distance(self.goal[v])
        for cell in sorted([*self.near[here], here], key=lambda c: (far[c], c in self._now)):
            other = self._now.get(cell)
            if cell in self._next or (pusher >= 0 and cell == self.where[pusher]):
                continue
            if other is not None and other != v and self._chosen.get(other) == here:
                continue
            self._next[cell], self._chosen[v] = v, cell
            if other is not None and other != v and other not in self._chosen and not self._choose(other, v):
                continue
            return True
        self._next[here], self._chosen[v] = v, here
        return False


def stand() -> float:
    """Mean time that a truck works at a place, the lift included [s]."""
    rng, lift = np.random.default_rng(0), TRUCK.lift
    visits = [random_visits(rng) for _ in range(2000)]
    up_down = 1.0 / lift.raise_speed + 1.0 / lift.lower_speed
    return float(np.mean([max(d, h * up_down + ENGAGE) for v in visits for d, h in zip(*v, strict=True)]))


def ours(crossings: int, trucks: int, seconds: float, seed: int, truck) -> tuple[float, float, object]:
    """Tasks done per truck and hour after the warm-up, the time on the way into a bay and out, the summary."""
    site = grid(crossings, crossings, PITCH)
    with TemporaryDirectory() as scratch, DatasetWriter.create(Path(scratch) / "run", "simulated", site) as w:
        settings = Settings(trucks, seconds, interval=10.0, seed=seed, soc=1.0)
        done = simulate(site, truck, w, settings, Demand(pause=1e-6))
        w.finish()
        dropped = read_table(Dataset(w.path), "tasks").dropped.dropna()
        late = pd.Timestamp(settings.start, unit="us", tz="UTC") + pd.Timedelta(seconds=WARM_UP * seconds)
        count = int((dropped > late).sum())
    spur = float(np.median(spur_times(build_world(site, truck, trucks))))
    return count / trucks / ((1.0 - WARM_UP) * seconds / 3600.0), 2.0 * spur, done


def pibt(crossings: int, trucks: int, seconds: float, seed: int, stand: float) -> float:
    """Tasks per agent and hour: two arrivals are one."""
    step = CELL / LIMIT
    agents = Agents(crossings, trucks, round(stand / step), seed)
    early = 0
    for k in range(round(seconds / step)):
        agents.step()
        early = agents.arrivals if k * step < WARM_UP * seconds else early
    return (agents.arrivals - early) / 2.0 / trucks / ((1.0 - WARM_UP) * seconds / 3600.0)


def compare(args: argparse.Namespace) -> list[tuple[float, ...]]:
    """A row a fleet: trucks, share of the cells, tasks per truck-hour of PIBT, sharp and plain trucks."""
    rows, cells = [], Agents(args.crossings, 1, 1, 0).cells
    print(
        "| trucks | cells full | PIBT | sharp | of PIBT | plain | deadlocks (broken) |\n" + "|---" * 7 + "|"
    )
    for trucks in map(int, args.trucks.split(",")):
        seconds = 60.0 * args.minutes
        sharp, manoeuvre, _ = ours(args.crossings, trucks, seconds, 1, SHARP)
        plain, _, done = ours(args.crossings, trucks, seconds, 1, TRUCK)
        best = pibt(args.crossings, trucks, seconds, 1, stand() + manoeuvre)
        rows.append((trucks, trucks / cells, best, sharp, plain))
        count = f"{done.count.deadlocks} ({done.count.deadlocks_released})"
        print(
            f"| {trucks} | {100 * trucks / cells:.0f} % | {best:.1f} | {sharp:.1f} | {sharp / best:.2f} |"
            f" {plain:.1f} | {count} |",
            flush=True,
        )
    return rows


def deadlocks(args: argparse.Namespace) -> None:
    """Hours of plain trucks, from a tenth to half of the cells full, until --hours are done."""
    cells, done, seed, begun = Agents(args.crossings, 1, 1, 0).cells, 0.0, 0, time.process_time()
    while done < args.hours:
        trucks = round(cells * (0.1, 0.2, 0.3, 0.4, 0.5)[seed % 5])
        _, _, summary = ours(args.crossings, trucks, 3600.0, seed, TRUCK)
        done, seed, c = done + 1.0, seed + 1, summary.count
        print(
            f"{done:.0f} h: {trucks} trucks, {c.deadlocks} deadlocks, {c.deadlocks_released} broken, longest"
            f" wait {summary.longest_wait_s:.0f} s, {time.process_time() - begun:.0f} CPU s",
            flush=True,
        )


def plot(rows: list[tuple[float, ...]], file: Path) -> None:
    """Tasks per hour of the whole fleet over the share of the cells."""
    import matplotlib.pyplot as plt

    table = np.array(rows)
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for column, label in ((2, "PIBT"), (3, "sharp trucks"), (4, "plain trucks")):
        axes.plot(100.0 * table[:, 1], table[:, column] * table[:, 0], "o-", label=label)
    axes.set(xlabel="cells full [%]", ylabel="tasks an hour", ylim=(0.0, None))
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--crossings", type=int, default=4)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--trucks", default="20,60,120,180,240")
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    sys.setrecursionlimit(10_000)
    if args.hours:
        deadlocks(args)
        return
    rows = compare(args)
    if args.plot:
        plot(rows, args.plot)


if __name__ == "__main__":
    main()
