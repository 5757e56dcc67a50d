"""The recorder behind the sample logs: eight trucks on the sample plant, twenty steps a second.

Another integrator, another driver and another noise than fleetlog's, so that what fleetlog finds in these logs was not put
there by fleetlog.  The trucks climb the ramp of ``plant.xodr``; ``roads.geojson`` is level.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from make_plant import CUT, PLACES, Way, bezier, turn_curve, turns, ways

DURATION = 1800.0
STEP = 0.05
G = 9.81
NOMINAL = dict(
    mass=4420.0, eta=0.79, regen=0.30, rolling=0.0146, aux=470.0, eta_lift=0.65, carriage=350.0, wh=30000.0
)
WAYS = ways()
NEXT: dict[Way, list[Way]] = {}
for a, b in turns():
    NEXT.setdefault(a, []).append(b)


def spots() -> dict[str, tuple[str, list[tuple[Way, float]]]]:
    """Every place: its kind, and the ways that pass it with the distance along each."""
    out = {}
    for name, kind, x, y in PLACES:
        near = []
        for way in WAYS:
            s = np.linspace(CUT, way.road.length - CUT, 400)
            d = [math.dist(way.at(v)[:2], (x, y)) for v in s]
            if min(d) < 1.6:
                near.append((way, float(s[int(np.argmin(d))])))
        out[name] = (kind, near)
    return out


SPOTS = spots()


def route(starts: list[tuple[Way, float]], ends: list[tuple[Way, float]]) -> list[tuple[Way, float, float]]:
    """The quickest (way, from, to) pieces from any start to any end; Dijkstra over ways."""
    goal = dict(ends)
    queue: list = []
    for i, (way, s) in enumerate(starts):
        heapq.heappush(queue, (0.0, i, way, s, None))
    seen: dict[Way, float] = {}
    count = len(starts)
    while queue:
        cost, _, way, s, back = heapq.heappop(queue)
        if way in goal and goal[way] > s + 1.0:
            pieces = [(way, s, goal[way])]
            while back is not None:
                way, s, back = back
                pieces.append((way, s, way.road.length - CUT))
            return pieces[::-1]
        if back is not None and seen.get(way, math.inf) <= cost:
            continue
        if back is not None:
            seen[way] = cost
        for after in NEXT[way]:
            count += 1
            heapq.heappush(
                queue,
                (cost + (way.road.length - s + 3.0) / way.road.speed, count, after, CUT, (way, s, back)),
            )
    raise SystemExit("no route")


class Path3:
    """A driven line: x, y, z, speed limit and curvature every 0.25 m."""

    def __init__(self, pieces: list[tuple[Way, float, float]], factor: float, lateral: float) -> None:
        points, limit = [], []
        for i, (way, s0, s1) in enumerate(pieces):
            for s in np.linspace(s0, s1, max(3, int((s1 - s0) / 0.2))):
                x, y, _, z = way.at(float(s))
                points.append((x, y, z))
                limit.append(min(way.road.speed, 2.0 if 44 < x < 52 else 9.9))
            if i + 1 < len(pieces):
                curve, z = turn_curve(way, pieces[i + 1][0]), way.at(s1)[3]
                points += [(*bezier(curve, t), z) for t in np.linspace(0.05, 0.95, 24)]
                limit += [min(way.road.speed, pieces[i + 1][0].road.speed)] * 24
        p = np.array(points)
        keep = np.r_[True, np.linalg.norm(np.diff(p[:, :2], axis=0), axis=1) > 1e-6]
        p, lim = p[keep], np.array(limit)[keep]
        d = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(p[:, :2], axis=0), axis=1))]
        self.s = np.arange(0.0, d[-1], 0.25)
        self.x, self.y, self.z = (np.interp(self.s, d, p[:, k]) for k in range(3))
        smooth = np.ones(5) / 5
        h = np.unwrap(np.arctan2(np.gradient(self.y), np.gradient(self.x)))
        k = np.abs(np.convolve(np.pad(np.gradient(h, 0.25), 2, mode="edge"), smooth, "valid"))
        v = np.minimum(np.interp(self.s, d, lim) * factor, np.sqrt(lateral / np.maximum(k, 1e-3)))
        v[-1] = 0.0
        for i in range(len(v) - 2, -1, -1):
            v[i] = min(v[i], math.sqrt(v[i + 1] ** 2 + 2 * 0.65 * 0.25))
        self.v, self.slope = v, np.gradient(self.z, 0.25)

    def at(self, s: float) -> tuple[float, float, float, float, float]:
        i = min(s / 0.25, len(self.s) - 1.001)
        j, f = int(i), i - int(i)
        mix = lambda a: a[j] * (1 - f) + a[j + 1] * f
        return mix(self.x), mix(self.y), mix(self.z), mix(self.v), mix(self.slope)


class Truck:
    """One truck, its driver and its small deviations from the data sheet."""

    def __init__(self, number: int, rng: np.random.Generator, tyres: float = 1.0) -> None:
        self.id, self.rng = f"T{number}", rng
        self.mass = NOMINAL["mass"] * rng.normal(1, 0.006)
        self.rolling = NOMINAL["rolling"] * tyres * rng.normal(1, 0.02)
        self.aux = NOMINAL["aux"] + rng.normal(0, 12)
        self.factor, self.lateral, self.pull = (
            rng.normal(0.92, 0.02),
            rng.normal(1.1, 0.05),
            rng.normal(0.55, 0.03),
        )
        names = [n for n, (kind, _) in SPOTS.items() if kind == ("pick" if number % 2 else "drop")]
        self.place = names[number % len(names)]
        self.soc, self.load, self.fork, self.v, self.s = rng.uniform(0.3, 0.7), 0.0, 0.3, 0.0, 0.0
        self.path: Path3 | None = None
        self.todo: list[tuple[str, float]] = [("wait", rng.uniform(2, 45))]
        self.blocked, self.power, self.rows = 0.0, 0.0, []
        self.noise = rng.normal(0, 0.08, 2)
        way, s = SPOTS[self.place][1][0]
        self.x, self.y, _, self.z = way.at(s)
        self.heading = way.at(s)[2]
        self.charging = False

    def plan(self, t: float, taken: set[str]) -> None:
        """The next trip, and what to do at its end."""
        kind = "drop" if self.load else "pick"
        east = self.x > 100
        free = [
            n for n, (k, near) in SPOTS.items() if k == kind and n != self.place and near and n not in taken
        ]
        rest = [n for n, (k, _) in SPOTS.items() if k == "park" and n not in taken]
        if not self.load and rest and self.rng.random() < 0.12:
            free = rest
        if self.id == "T7" and t > 1050 and not self.load:
            free = ["charger-1"]
        if not free:
            self.todo = [("wait", 3.0)]
            return
        other = [n for n in free if (SPOTS[n][1][0][0].at(5)[0] > 100) != east]
        goal = str(self.rng.choice(other if other and self.rng.random() < 0.75 else free))
        pieces = route(SPOTS[self.place][1], SPOTS[goal][1])
        self.path, self.s, self.place = Path3(pieces, self.factor, self.lateral), 0.0, goal
        top = self.rng.uniform(0.8, 3.2)
        if goal.startswith("charger"):
            self.todo = [("charge", 1e9)]
        elif goal.startswith("parking"):
            self.todo = [("wait", self.rng.uniform(70, 150))]
        else:
            load = self.rng.uniform(300, 1900) if kind == "pick" else 0.0
            pause = self.rng.uniform(2, 6)
            self.todo = [
                ("wait", pause),
                ("fork", top),
                ("load", load),
                ("wait", self.rng.uniform(1, 4)),
                ("fork", 0.3),
                ("wait", pause),
            ]

    def drive(self, others: list[Truck]) -> float:
        """One step along the path; the acceleration."""
        _, _, _, target, _ = self.path.at(self.s)
        near = math.inf
        c, s = math.cos(self.heading), math.sin(self.heading)
        for o in others:
            dx, dy = o.x - self.x, o.y - self.y
            ahead, side = dx * c + dy * s, abs(-dx * s + dy * c)
            if o is not self and 0 < ahead < 9 and side < 1.35 + 0.12 * ahead:
                near = min(near, ahead)
        if near < 9 and self.blocked < 5.0:
            target = min(target, max(0.0, 0.6 * (near - 4.2)))
        self.blocked = (
            self.blocked + STEP if near < 4.6 and self.v < 0.1 else max(0.0, self.blocked - 0.4 * STEP)
        )
        wanted = (target - self.v) / 0.35
        a = float(np.clip(wanted, -0.9, self.pull))
        if self.v + a * STEP < 0.05 and self.s < self.path.s[-1] - 0.4 and target > 0:
            a = 0.3
        return a

    def step(self, t: float, others: list[Truck]) -> None:
        v0, a, lift, slope = self.v, 0.0, 0.0, 0.0
        if self.path is not None:
            a = self.drive(others)
            self.v = max(0.0, self.v + a * STEP)
            self.s += 0.5 * (v0 + self.v) * STEP
            x, y, self.z, _, slope = self.path.at(self.s)
            if math.hypot(x - self.x, y - self.y) > 1e-4:
                self.heading = math.atan2(y - self.y, x - self.x)
            self.x, self.y = x, y
            if self.s >= self.path.s[-1] - 0.3:
                self.path, self.v = None, 0.0
        elif self.todo:
            lift = self.handle()
        else:
            self.plan(t, {o.place for o in others if o is not self})
        v, m = 0.5 * (v0 + self.v), self.mass + self.load
        f = (
            m * (self.v - v0) / STEP
            + (m * G * (self.rolling * math.cos(math.atan(slope)) if v > 0 else 0.0))
            + m * G * math.sin(math.atan(slope))
        )
        drive = f * v / NOMINAL["eta"] if f * v > 0 else f * v * NOMINAL["regen"]
        work = (self.load + NOMINAL["carriage"]) * G * lift
        p = drive + (work / NOMINAL["eta_lift"] if work > 0 else 0.0) + self.aux
        if self.charging:
            p = -5200.0
        self.power += 0.25 * (p - self.power)  # the meter settles within a fifth of a second
        self.soc -= p * STEP / (3600 * NOMINAL["wh"])

    def handle(self) -> float:
        what, value = self.todo[0]
        if what == "fork":
            speed = 0.35 if value > self.fork else -0.45
            self.fork += speed * STEP
            if (speed > 0) == (self.fork >= value):
                self.fork, self.todo = value, self.todo[1:]
            return speed
        if what == "load":
            self.load, self.todo = value, self.todo[1:]
        elif what in ("wait", "charge"):
            self.charging = what == "charge"
            self.todo = [(what, value - STEP), *self.todo[1:]] if value > STEP else self.todo[1:]
        return 0.0

    def log(self, t: float) -> None:
        r = self.rng
        self.noise = 0.9 * self.noise + r.normal(0, 0.08 * math.sqrt(1 - 0.81), 2)
        n = self.noise + r.normal(0, 0.04, 2)
        p = self.power * r.normal(1, 0.01) + r.normal(0, 25)
        weighed = 0.0 if not self.load else self.load * r.normal(1, 0.002)
        self.rows.append(
            (
                t,
                self.x + n[0],
                self.y + n[1],
                max(0.0, self.v + r.normal(0, 0.015)),
                weighed,
                self.fork,
                p,
                self.soc,
                self.heading,
                self.charging,
            )
        )


def record(
    seed: int = 20260302, fleet: int = 8, duration: float = DURATION, tyres: float = 1.0
) -> list[Truck]:
    """Drive a fleet for a time [s]; ``tyres`` is the factor on its rolling resistance."""
    rng = np.random.default_rng(seed)
    trucks = [Truck(i, np.random.default_rng(rng.integers(1 << 31)), tyres) for i in range(1, fleet + 1)]
    phase = [float(rng.uniform(0, 1)) for _ in trucks]
    for k in range(int(duration / STEP)):
        t = k * STEP
        for truck, p in zip(trucks, phase, strict=True):
            truck.step(t, trucks)
            if t >= 1.0 and int(t + p) != int(t + p - STEP):
                truck.log(t)
    return trucks
