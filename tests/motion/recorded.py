"""Clean drives of the blind recorder with their truth at 20 Hz.

And logs of them as different loggers would write them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent / "blind"))
import tempfile
from dataclasses import replace

import power as recorder
from cases import Case
from effects import Effect, Scope
from shifts import shift
from trucks import Truck as Numbers
from world import world

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import Truck, load_truck
from fleetlog.roads import load_site
from fleetlog.roads.matching import match

Floats = NDArray[np.float64]
HZ = recorder.HZ


@dataclass(frozen=True)
class Drives:
    """One truck's shift.

    ``truth`` by name at 20 Hz (v, x, y, bend, load, height, lift), power [W], truck, roads.
    """

    truth: dict[str, Floats]
    power: Floats
    truck: Truck
    network: Network

    def energy(self, low: Floats, high: Floats) -> Floats:
        """Joules between (n,) and (n,) seconds."""
        total = np.concatenate([[0.0], np.cumsum(self.power) / HZ])
        at = np.arange(len(total)) / HZ
        return np.interp(high, at, total) - np.interp(low, at, total)


@dataclass(frozen=True)
class Logger:
    """How a shift is written down.

    ``steps`` [s] between rows, in turn; ``jitter`` [s] of the stamps (not of the samples); ``speed``,
    ``position`` noise (None: no such channel); ``mean`` speed over the interval before the row; ``repeat``
    rows for each new position.
    """

    steps: tuple[float, ...] = (1.0,)
    jitter: float = 0.0
    speed: float | None = 0.03
    position: float = 0.05
    mean: bool = False
    repeat: int = 1


def drives(seed: int, hours: float = 1.0, scrub: float = 0.0) -> Drives:
    """A clean shift of one truck; ``scrub`` is its cornering coefficient [m]."""
    w = world(Case(seed=seed, hours=hours, vehicles=1))
    own = w.truck.own(np.random.default_rng([seed, 7, 0]))
    motion, _ = shift(w, 0, 0, np.random.default_rng([seed, 8, 0, 0]))
    # The truth has a temperature and a slope that no load or map of these tests follows.
    motion = replace(motion, slope=np.zeros(len(motion)))
    effects = [Effect("cornering_resistance", {"k": scrub}, (), Scope())] if scrub else []
    terminal, _ = recorder.balance(motion, own, effects, 0)
    with tempfile.TemporaryDirectory() as folder:
        w.site.write(Path(folder))
        network = load_site(Path(folder) / "site.toml")[0].roads()
        w.file.write(Path(folder) / "truck.toml")
        truck = _own(load_truck(Path(folder) / "truck.toml"), own)
    truth = {k: np.asarray(v) for k, v in vars(motion).items()}
    return Drives(truth, terminal, truck, network)


def _own(file: Truck, own: Numbers) -> Truck:
    values = {"chassis.mass": own.mass, "drive.efficiency": own.efficiency, "resistance.rolling": own.rolling,
              "auxiliary.power": own.power}  # fmt: skip
    for key, value in values.items():
        file = file.with_value(key, value)
    return file


def logged(shift: Drives, logger: Logger, seed: int = 0, *, matched: bool = True) -> Trajectory:
    """The rows that a logger writes of a shift, as import would read them."""
    rng = np.random.default_rng([seed, 7])
    w, n = shift.truth, len(shift.power)
    steps = np.tile(logger.steps, int(n / HZ / sum(logger.steps)) + 1)
    t = 0.5 * steps[0] + np.concatenate([[0.0], np.cumsum(steps[:-1])])
    t = t[t < n / HZ - 1.0]
    stamp = t + logger.jitter * rng.uniform(-1.0, 1.0, len(t))
    stamp = np.maximum.accumulate(stamp + 1e-3 * np.arange(len(t))) - 1e-3 * np.arange(len(t)) * 0.999
    # The tick k covers k / HZ to (k + 1) / HZ.
    fine = (np.arange(n) + 0.5) / HZ
    pick = np.clip((t * HZ).astype(int), 0, n - 1)
    columns: dict[str, object] = {
        "payload": w["load"][pick], "fork_height": np.interp(t, fine, w["height"]),
        "battery_power": _mean(shift, stamp),
    }  # fmt: skip
    fresh = (np.arange(len(t)) // logger.repeat) * logger.repeat
    for name in ("x", "y"):
        noisy = np.interp(t, fine, w[name]) + _wander(len(t), logger, rng)
        columns[name] = noisy[fresh]
    if logger.speed is not None:
        way = np.concatenate([[0.0], np.cumsum(w["v"])]) / HZ
        at = np.arange(n + 1) / HZ
        v = np.interp(t, fine, w["v"])
        if logger.mean:
            before = np.append(t[:1] - steps[0], t[:-1])
            v = (np.interp(t, at, way) - np.interp(before, at, way)) / (t - before)
        noise = logger.speed * rng.normal(size=len(t))
        columns["speed"] = np.where(v <= 1e-9, 0.0, np.maximum(v + noise, 0.0))
    log = Trajectory("T", np.round(stamp * 1e6).astype(np.int64), columns)
    if not matched:
        return log
    found = match(log, shift.network)
    return log.with_columns(edge_id=Labels(found.edge, shift.network.edge_ids), edge_offset=found.offset)


def _wander(n: int, logger: Logger, rng: np.random.Generator) -> Floats:
    return logger.position * rng.normal(size=n)


def _mean(shift: Drives, stamp: Floats) -> Floats:
    """Mean power over what each row stands for."""
    middle = 0.5 * (stamp[1:] + stamp[:-1])
    low, high = np.append(2 * stamp[0] - middle[0], middle), np.append(middle, 2 * stamp[-1] - middle[-1])
    return shift.energy(low, high) / (high - low)
