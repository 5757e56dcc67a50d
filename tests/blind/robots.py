"""Another world: mobile robots that turn on the spot, on the aisles of a grid, and drive through one another.

Forces are balanced as for any truck; nobody is ever in another's way.  Written to be unlike recorder.py: straight
runs from stop to stop, speed by a controller, 5 Hz, no lifting.
"""

from __future__ import annotations

import gzip
import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import networkx as nx
import numpy as np

NX, NY, AISLE = 9, 6, 6.0
LATITUDE, LONGITUDE = 48.1, 11.5
METRES = 111_190.0  # A degree of latitude here [m]
SPEED, RATE, STEP = 1.8, 0.7, 0.05
MASS, ROLLING, EFFICIENCY, BACK, STANDBY = 320.0, 0.018, 0.82, 0.4, 95.0
TURN = 0.9  # On the spot [rad/s]
DOOR = (4, 2)
Node = tuple[int, int]

TRUCK = f"""name = "robot"
[chassis]
mass = {MASS}
turn_radius = 0.3
[drive]
efficiency = {EFFICIENCY}
regeneration = {BACK}
speed_factor = 1.0
max_acceleration = {RATE}
max_deceleration = {RATE}
[resistance]
rolling = {ROLLING}
drag_area = 0.0
[lift]
carriage_mass = 0.0
[auxiliary]
power = {STANDBY}
[battery]
voltage = 48.0
capacity_wh = 1500.0
"""


@dataclass
class Robot:
    """One robot's log: rows of time, x, y, speed, payload and battery power."""

    number: int
    concealed: str
    rng: np.random.Generator
    load: float = 0.0
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def stay(self, x: float, y: float, seconds: float) -> None:
        for _ in range(int(seconds / STEP)):
            self.put(x, y, 0.0, 0.0)

    def put(self, x: float, y: float, speed: float, acceleration: float) -> None:
        mass = MASS + self.load
        drag = 40.0 if self.concealed == "drag" and self.number == 2 else 0.0
        force = mass * acceleration + (mass * 9.80665 * ROLLING + drag) * (speed > 0.0)
        power = force * speed
        power = power / EFFICIENCY if power > 0.0 else power * EFFICIENCY * BACK
        self.rows.append((len(self.rows) * STEP, x, y, speed, self.load, power + STANDBY))

    def drive(self, a: Node, b: Node) -> None:
        """From rest to rest along a straight run."""
        (x0, y0), (x1, y1) = ((AISLE * i, AISLE * j) for i, j in (a, b))
        length, s, v = math.hypot(x1 - x0, y1 - y0), 0.0, 0.0
        top, rate = SPEED * (1.0 + 0.02 * self.rng.normal()), RATE * (1.0 + 0.04 * self.rng.normal())
        while s < length - 1e-3:
            target = min(top, math.sqrt(2.0 * rate * (length - s)))
            change = max(-1.2 * rate, min(rate, (target - v) / STEP))
            new = max(v + change * STEP, 0.02)
            s += 0.5 * (v + new) * STEP
            share = min(s / length, 1.0)
            self.put(x0 + (x1 - x0) * share, y0 + (y1 - y0) * share, new, (new - v) / STEP)
            v = new

    def work(self, aisles: nx.Graph, seconds: float) -> None:
        at, course = (0, 0), 0.0
        while len(self.rows) * STEP < seconds:
            goal = (int(self.rng.integers(NX)), int(self.rng.integers(NY)))
            for a, b in straight(nx.shortest_path(aisles, at, goal), self.concealed):
                new = math.atan2(b[1] - a[1], b[0] - a[0])
                angle = abs((new - course + math.pi) % (2.0 * math.pi) - math.pi)
                self.stay(AISLE * a[0], AISLE * a[1], angle / TURN)
                self.drive(a, b)
                course = new
                if self.concealed == "door" and b == DOOR:
                    self.stay(AISLE * b[0], AISLE * b[1], self.rng.uniform(5.0, 15.0))
            at, half = goal, self.rng.uniform(4.0, 12.0)
            self.stay(AISLE * at[0], AISLE * at[1], half)
            self.load = 0.0 if self.load else self.rng.uniform(80.0, 250.0)
            self.stay(AISLE * at[0], AISLE * at[1], half)


def straight(path: list[Node], concealed: str) -> list[tuple[Node, Node]]:
    """First and last node of the straight runs of a path; a door ends one."""
    first, out = path[0], []
    for k in range(1, len(path)):
        (x, y), (px, py) = path[k], path[k - 1]
        goes_on = k + 1 < len(path) and path[k + 1] == (2 * x - px, 2 * y - py)
        if not goes_on or (concealed == "door" and (x, y) == DOOR):
            out.append((first, (x, y)))
            first = (x, y)
    return out


def degrees(x: float, y: float) -> tuple[float, float]:
    """Longitude and latitude."""
    return LONGITUDE + x / (METRES * math.cos(math.radians(LATITUDE))), LATITUDE + y / METRES


def record(folder: Path, concealed: str = "", *, robots: int = 5, hours: float = 1.5, seed: int = 1) -> None:
    """Write map, truck file and log; ``concealed`` is nothing, ``drag`` (40 N of one) or a ``door``."""
    folder.mkdir(parents=True, exist_ok=True)
    aisles = nx.Graph(((i, j), (i + 1, j)) for i in range(NX - 1) for j in range(NY))
    aisles.add_edges_from(((i, j), (i, j + 1)) for i in range(0, NX, 2) for j in range(NY - 1))
    roads = []
    for a, b in aisles.edges:
        ends = [degrees(AISLE * n[0], AISLE * n[1]) for n in (a, b)]
        names = {"id": f"{a[0]}{a[1]}-{b[0]}{b[1]}", "from": f"{a[0]}{a[1]}", "to": f"{b[0]}{b[1]}"}
        line = {"type": "LineString", "coordinates": ends}
        about = {**names, "oneway": False, "speed_limit": SPEED}
        roads.append({"type": "Feature", "properties": about, "geometry": line})
    (folder / "roads.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": roads}))
    (folder / "truck.toml").write_text(TRUCK)
    frame = f"[frame]\nlatitude = {LATITUDE}\nlongitude = {LONGITUDE}\n"
    (folder / "site.toml").write_text(f'name = "aisles"\n{frame}[network]\nfile = "roads.geojson"\n')
    rng = np.random.default_rng(seed)
    lines = ["vehicle_id,timestamp,longitude,latitude,speed,payload,battery_power"]
    for number in range(robots):
        robot = Robot(number, concealed, rng)
        robot.work(aisles, 3600.0 * hours)
        for time, x, y, speed, load, power in robot.rows[::4]:
            lon, lat = degrees(x + 0.02 * rng.normal(), y + 0.02 * rng.normal())
            shown = (
                max(speed + 0.005 * rng.normal() * (speed > 0.0), 0.0),
                load,
                power * (1.0 + 0.01 * rng.normal()),
            )
            lines.append(
                f"R{number},{1775030400 + time:.2f},{lon:.9f},{lat:.9f},{shown[0]:.3f},{shown[1]:.1f},{shown[2]:.1f}"
            )
    with gzip.open(folder / "recorded.csv.gz", "wt") as stream:
        stream.write("\n".join(lines) + "\n")
