"""Throughput over density against PIBT (Okumura et al., Artificial Intelligence 310, 2022), on one grid.

    python tests/benchmarks/density_pibt.py [--crossings 4] [--minutes 20] [--trucks 20,60,120] [--plot FILE]
    python tests/benchmarks/density_pibt.py --hours 100

The roads have two lanes.  PIBT sees them as cells as long as a truck and the gap before it, two side by side, in
which an agent goes to a neighbouring free cell in the time that a truck at the speed limit needs for one.
Tasks are endless on both sides: to a random place, stand beside the road, to another, stand.  There are two PIBT:

``free``   as published on grids: an agent goes to any neighbouring cell, on any side of the road, and into a cell that
           another leaves in the same step, whichever way that goes.  It vanishes when it arrives, anywhere.
``lanes``  on the same map: it keeps to its lane, its places are the bays of the simulated site, with their
           doors.  It turns in or out in the time of a sharp truck at that door, rounded up or down to steps at
           random so that the mean is right.  Meanwhile it keeps its cell, and the cell of the opposite lane that
           it crosses on the way, as long as the truck keeps those lanes: until its footprint has left them.  For
           that it pushes others away as for a cell that it goes to.  It does not follow
           round a corner into a cell that is being left: trucks of 3.0 by 1.2 m would overlap there (halfway both are
           within 0.2 m of the corner).  No other number is changed; it may still turn round within a crossing, and
           start and stop at once.

The truck of ``sharp`` is made comparable the other way: it gathers and loses speed within a cell and turns at the
speed limit.  All fleets meet the same site: places for the largest of them.

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
from fleetlog.simulate.state import creep_speed
from fleetlog.simulate.tasks import ENGAGE, Demand, random_visits
from fleetlog.simulate.world import build_world
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.events import read_table

PITCH, LIMIT, CELL = 60.0, 3.0, 4.0
"""Between crossings [m], speed limit [m/s], length of a truck with its gap [m]."""
STEP = CELL / LIMIT  # Of PIBT [s]
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
        self.cells, self.stand, self._behind = len(at), stand, self.near
        self._distance: dict[int, np.ndarray] = {}
        self.where = self.rng.permutation(self.cells)[:agents].tolist()
        self.goal = self.rng.integers(self.cells, size=agents).tolist()
        self.priority = self.rng.random(agents)
        self.away, self._on = np.zeros(agents, int), [True] * agents
        self._across: dict[int, int] = {}  # Cells that an agent crosses, beside its own
        self.arrivals = 0

        self.at = at

    def _ends(self, goal: int) -> list[int]:
        """The cells at which a goal is reached."""
        return [goal]

    def distance(self, goal: int) -> np.ndarray:
        """Steps from every cell to the nearest of a goal's."""
        if goal not in self._distance:
            out, front = np.full(self.cells, 10**6), self._ends(goal)
            out[front] = 0
            while front:
                ahead = {n: out[c] + 1 for c in front for n in self._behind[c] if out[n] == 10**6}
                for n, far in ahead.items():
                    out[n] = far
                front = list(ahead)
            self._distance[goal] = out
        return self._distance[goal]

    def step(self) -> None:
        """Everyone goes on by a cell at most; who is done leaves the road to stand beside it."""
        self.away = np.maximum(self.away - 1, 0)
        taken = {c for v, c in enumerate(self.where) if self._on[v]} | self._across.keys()
        for v in np.argsort(-self.priority).tolist():
            if not self._on[v] and self.away[v] == 0:
                self._come(v, taken)
        self._now = {self.where[v]: v for v in range(len(self.where)) if self._on[v]}
        self._chosen = {v: self.where[v] for v in self._now.values() if self._stays(v)}
        self._next = {cell: v for v, cell in self._chosen.items()} | self._across
        self._now |= self._across
        for v in np.argsort(-self.priority).tolist():
            if self._on[v] and v not in self._chosen:
                self._choose(v, -1)
        for v, cell in self._chosen.items():
            self.where[v] = cell
            self.priority[v] += 1.0
            if self._done(v, cell):
                self._on[v], self.away[v] = False, self.stand
                self.arrivals += 1
                self.priority[v] %= 1.0
                self._go_on(v)

    def _come(self, v: int, taken: set[int]) -> None:
        """Back onto the road, if the cell is not ``taken``."""
        if self.where[v] not in taken:
            self._on[v] = True
            taken.add(self.where[v])

    def _stays(self, v: int) -> bool:
        return False

    def _done(self, v: int, cell: int) -> bool:
        return cell == self.goal[v]

    def _go_on(self, v: int) -> None:
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
            if other is not None and other != v and not self._may_follow(here, cell, self._chosen[other]):
                if self._next.get(cell) == v:
                    del self._next[cell]
                continue
            return True
        self._next[here], self._chosen[v] = v, here
        return False

    def _may_follow(self, here: int, cell: int, onward: int) -> bool:
        """Whether an agent may go to a cell that another leaves for ``onward`` meanwhile."""
        return True


class LaneAgents(Agents):
    """PIBT on lanes and with footprints, between the bays of a simulated site: see above."""

    def __init__(self, world, crossings: int, agents: int, stand: int, seed: int) -> None:
        super().__init__(crossings, 1, stand, seed)
        road, number = round(PITCH / CELL), {tuple(c): k for k, c in enumerate((self.at - 1).tolist())}
        size, everywhere = (crossings - 1) * road + 2, self.near
        self.near = [[] for _ in everywhere]
        for (x, y), k in number.items():
            up, right = (x % road == 1) - (x % road == 0), (y % road == 0) - (y % road == 1)
            ahead = (number.get((x, y + up)) if up else None, number.get((x + right, y)) if right else None)
            self.near[k] = [c for c in ahead if c is not None]
        self._behind: list[list[int]] = [[] for _ in self.near]
        for k, ahead in enumerate(self.near):
            for c in ahead:
                self._behind[c].append(k)
        track = world.track

        def cell(lane: int, at: float) -> int:
            k = int(
                np.clip(
                    track.first[lane] + round(at / track.spacing[lane]),
                    *track.first[lane : lane + 2] - [0, 1],
                )
            )
            along = [int(np.clip((p[k] + CELL) // CELL, 0, size - 1)) for p in (track.x, track.y)]
            c, s = np.cos(track.heading[k]), np.sin(track.heading[k])
            if abs(c) > abs(s):
                along[1] = round(track.y[k] / PITCH) * road + int(c < 0.0)
            else:
                along[0] = round(track.x[k] / PITCH) * road + int(s > 0.0)
            return number[along[0], along[1]]

        def across(d) -> int:
            """The cell of the lane that a door crosses, else its own."""
            return cell(d.crosses, 0.5 * (d.low + d.high)) if d.crosses >= 0 else cell(d.lane, d.at)

        times, roads = spur_times(world), world.roads
        creep = creep_speed(world.truck)
        self._time, self._off = times / STEP, roads.door_off / creep / STEP
        self._clear = np.minimum(times - roads.door_onto / creep, times) / STEP
        self.doors = [
            {cell(d.lane, d.at): (across(d), k) for k, d in ((k, world.doors[k]) for k in reversed(doors))}
            for doors in world.ways.of_bay
        ]
        self.bay = self.rng.permutation(len(self.doors))[:agents].tolist()
        self._taken = set(self.bay)
        self.where, self._on, self._turns_in = [-1] * agents, [False] * agents, [False] * agents
        self.priority, self.away, self._busy = self.rng.random(agents), np.ones(agents, int), [0] * agents
        self._keeps = [0] * agents  # A lane is given back when so many steps of a turn are left
        self.goal = [self._draw() for _ in range(agents)]

    def _draw(self) -> int:
        free = [b for b in range(len(self.doors)) if b not in self._taken]
        bay = int(free[self.rng.integers(len(free))])
        self._taken.add(bay)
        return bay

    def _ends(self, goal: int) -> list[int]:
        """The cells of the doors of a bay."""
        return list(self.doors[goal])

    def _come(self, v: int, taken: set[int]) -> None:
        far, doors = self.distance(self.goal[v]), self.doors[self.bay[v]]
        out = min(doors, key=lambda c: far[c])
        across, door = doors[out]
        if not taken & {out, across}:
            self._on[v], self.where[v] = True, out
            self._turn(v, across, door, inward=False)
            taken |= {out, across}
            self._taken.discard(self.bay[v])

    def _turn(self, v: int, across: int, door: int, inward: bool) -> None:
        """Begin to turn in or out."""
        luck, back = self.rng.random(), self._off if inward else self._clear
        self._turns_in[v], self._busy[v] = inward, int(self._time[door] + luck)
        self._keeps[v] = self._busy[v] - int(back[door] + luck)
        self._across[across] = v

    def _stays(self, v: int) -> bool:
        """Who turns in or out keeps its cell meanwhile."""
        return self._busy[v] > 0

    def _choose(self, v: int, pusher: int) -> bool:
        here = self.where[v]
        across, door = self.doors[self.goal[v]].get(here, (None, -1))
        if across is None or here in self._next or across in self._next:
            return super()._choose(v, pusher)
        self._next[here] = self._next[across] = v
        self._chosen[v] = here
        other = self._now.get(across)
        if other in (None, v) or self._chosen.get(other, across) != across or self._choose(other, v):
            self._turn(v, across, door, inward=True)
            return False
        del self._next[here], self._chosen[v]
        if self._next[across] == v:
            del self._next[across]
        return super()._choose(v, pusher)

    def _done(self, v: int, cell: int) -> bool:
        if self._busy[v] > 0:
            self._busy[v] -= 1
            if self._busy[v] == self._keeps[v] or self._busy[v] == 0:
                crossed = [c for c, u in self._across.items() if u == v]
                for c in crossed:
                    del self._across[c]
                    # On the way in its own lane is the first that it leaves.
                    self.where[v] = c if self._turns_in[v] else cell
            return self._busy[v] == 0 and self._turns_in[v]
        across, door = self.doors[self.goal[v]].get(cell, (None, -1))
        if across == cell or (across is not None and across not in self._next):
            self._turn(v, across, door, inward=True)
            self._next[across] = v
        return False

    def _go_on(self, v: int) -> None:
        self.bay[v], self.goal[v] = self.goal[v], self._draw()

    def _may_follow(self, here: int, cell: int, onward: int) -> bool:
        return onward == cell or bool(
            (self.at[onward] - self.at[cell] == self.at[cell] - self.at[here]).all()
        )


def stand() -> float:
    """Mean time that a truck works at a place, the lift included [s]."""
    rng, lift = np.random.default_rng(0), TRUCK.lift
    visits = [random_visits(rng) for _ in range(2000)]
    up_down = 1.0 / lift.raise_speed + 1.0 / lift.lower_speed
    return float(np.mean([max(d, h * up_down + ENGAGE) for v in visits for d, h in zip(*v, strict=True)]))


def ours(crossings: int, trucks: int, room: int, seconds: float, seed: int, truck) -> tuple[float, object]:
    """Tasks done per truck and hour after the warm-up, on a site for ``room`` trucks; the summary."""
    site = grid(crossings, crossings, PITCH)
    with TemporaryDirectory() as scratch, DatasetWriter.create(Path(scratch) / "run", "simulated", site) as w:
        settings = Settings(trucks, seconds, interval=10.0, seed=seed, soc=1.0, room=room)
        done = simulate(site, truck, w, settings, Demand(pause=1e-6))
        w.finish()
        dropped = read_table(Dataset(w.path), "tasks").dropped.dropna()
        late = pd.Timestamp(settings.start, unit="us", tz="UTC") + pd.Timedelta(seconds=WARM_UP * seconds)
        count = int((dropped > late).sum())
    return count / trucks / ((1.0 - WARM_UP) * seconds / 3600.0), done


def pibt(agents: Agents, trucks: int, seconds: float) -> float:
    """Tasks per agent and hour: two arrivals are one."""
    early = 0
    for k in range(round(seconds / STEP)):
        agents.step()
        early = agents.arrivals if k * STEP < WARM_UP * seconds else early
    return (agents.arrivals - early) / 2.0 / trucks / ((1.0 - WARM_UP) * seconds / 3600.0)


def compare(args: argparse.Namespace) -> list[tuple[float, ...]]:
    """A row a fleet: trucks, share of the cells, tasks per truck-hour of both PIBT, sharp and plain trucks."""
    rows, cells, fleets = [], Agents(args.crossings, 1, 1, 0).cells, [int(n) for n in args.trucks.split(",")]
    world = build_world(grid(args.crossings, args.crossings, PITCH), SHARP, 1, room=max(fleets))
    turn, seconds = float(np.mean(spur_times(world))), 60.0 * args.minutes
    work, away = round(stand() / STEP), round((stand() + 2.0 * turn) / STEP)
    print(
        "| trucks | cells full | PIBT, free | PIBT, lanes | sharp | of lanes | plain | plain, in all | deadlocks |\n"
        + "|---" * 9
        + "|"
    )
    for n in fleets:
        found: list[list[float]] = [[], [], [], []]
        count = 0
        for seed in range(1, args.seeds + 1):
            found[0].append(pibt(Agents(args.crossings, n, away, seed), n, seconds))
            kept = LaneAgents(world, args.crossings, n, work, seed)
            found[1].append(pibt(kept, n, seconds))
            for k, truck in ((2, SHARP), (3, TRUCK)):
                rate, done = ours(args.crossings, n, max(fleets), seconds, seed, truck)
                found[k].append(rate)
                count += done.count.deadlocks
        free, lanes, sharp, plain = (float(np.mean(f)) for f in found)
        rows.append((n, n / cells, free, lanes, sharp, plain))
        print(
            f"| {n} | {100 * n / cells:.0f} % | {free:.1f} | {lanes:.1f} | {sharp:.1f} | {sharp / lanes:.2f} |"
            f" {plain:.1f} | {n * plain:,.0f} | {count} |",
            flush=True,
        )
    return rows


def deadlocks(args: argparse.Namespace) -> None:
    """Hours of plain trucks, from a tenth to half of the cells full, until --hours are done."""
    cells, done, seed, begun = Agents(args.crossings, 1, 1, 0).cells, 0.0, args.seed, time.process_time()
    while done < args.hours:
        trucks = round(cells * (0.1, 0.2, 0.3, 0.4, 0.5)[seed % 5])
        _, summary = ours(args.crossings, trucks, trucks, 3600.0, seed, TRUCK)
        done, seed, c = done + 1.0, seed + 1, summary.count
        print(
            f"{done:.0f} h: {trucks} trucks, {c.tasks_done} tasks, {c.deadlocks} deadlocks, {c.deadlocks_released}"
            f" broken, longest wait {summary.longest_wait_s:.0f} s, {time.process_time() - begun:.0f} CPU s",
            flush=True,
        )


def plot(rows: list[tuple[float, ...]], file: Path) -> None:
    """Tasks per hour of the whole fleet over the share of the cells."""
    import matplotlib.pyplot as plt

    table = np.array(rows)
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for column, label in ((2, "PIBT, free"), (3, "PIBT, lanes"), (4, "sharp trucks"), (5, "plain trucks")):
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
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0, help="first seed with --hours")
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
