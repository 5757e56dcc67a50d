"""One truck's day as its logger tells it, and the same power as models of it would have it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import engine
import numpy as np
import polars as pl
from effects import Effect
from loggers import (
    DECIMALS,
    Logger,
    moments,
    noisy_power,
    reported_power,
    seen_position,
    seen_speed,
    stamps,
    stepped,
)
from power import HZ, Motion, balance, capacity
from scipy.ndimage import gaussian_filter1d
from sites import LATITUDE, LONGITUDE, METRE, METRE_EAST
from trucks import TOLERANCE, Truck
from world import World


@dataclass
class Seen:
    """Energy of one truck-day by windows [J]: as logged, and by models; by channel."""

    vehicle: int
    logged: dict[str, np.ndarray] = field(default_factory=dict)
    models: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    """By channel and by the effect left out: ``""`` none, ``*`` all."""
    adjust: dict[str, np.ndarray] = field(default_factory=dict)
    """(windows, tolerances) change of the model by one tolerance of the truck file each."""


def observe(
    w: World, m: Motion, own: Truck, vehicle: int, rng: np.random.Generator
) -> tuple[pl.DataFrame, Seen]:
    """Rows of the log, and the windows that tell what the best model could know."""
    logger = w.logger
    ticks = moments(len(m), logger, rng)
    if w.case.by == "engine":
        m, terminal, cell = engine.drive(w, m, own, vehicle)
    else:
        terminal, cell = balance(m, own, w.effects, vehicle, w.truck)
    charge = np.nan_to_num(m.charge)
    at_terminal = terminal - charge if logger.charging == "inside" else terminal
    power = noisy_power(reported_power(at_terminal, ticks, logger, _averaging(w.effects)), logger, rng)
    soc = _state_of_charge(m, cell - charge, capacity(m, own, w.effects, vehicle))[ticks]
    scale = _speed_scale(w.effects, m, vehicle)
    x, y = seen_position(m, ticks, logger, rng)
    columns = {
        "latitude": LATITUDE + y * METRE,
        "longitude": LONGITUDE + x * METRE_EAST,
        "speed": seen_speed(m, ticks, logger, scale, rng),
        "payload": m.weighed[ticks],
        "fork_height": m.height[ticks],
        "battery_power": power,
        "soc": stepped(soc, logger.soc_step),
        "ambient_temperature": m.temperature[ticks],
    }
    kept = {k: np.round(v, DECIMALS[k]) for k, v in columns.items() if k not in logger.without}
    who = [f"T{vehicle + 1}"] * len(ticks)
    table = pl.DataFrame({"vehicle_id": who, "timestamp": stamps(m.t[ticks], logger, rng), **kept})
    known = replace(m, v=_known_speed(m, ticks, logger, columns["speed"] / scale[ticks], (x, y)))
    return table, _windows(w, known, vehicle, ticks, kept, m)


def _averaging(effects: Iterable[Effect]) -> float:
    return sum(e.parameters["interval"] for e in effects if e.term == "averaging")


def _speed_scale(effects: Iterable[Effect], m: Motion, vehicle: int) -> np.ndarray:
    scale = np.ones(len(m))
    for e in effects:
        if e.term == "speed_scale":
            scale += e.scope.weight(vehicle, m.t) * (e.parameters["factor"] - 1.0)
    return scale


def _state_of_charge(m: Motion, cell: np.ndarray, watt_hours: np.ndarray | float) -> np.ndarray:
    """From 97 % down; a fresh battery has 97 % again."""
    used = np.cumsum(cell / watt_hours) / HZ / 3600.0
    for swap in np.flatnonzero(np.isnan(m.charge)):
        used[swap:] -= used[swap]
    return 0.97 - used


def _known_speed(
    m: Motion, ticks: np.ndarray, logger: Logger, speed: np.ndarray, at: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The true speed with what smoothing leaves of the noise of the channel that tells it."""
    if "speed" not in logger.without:
        error, blur = (speed - m.v[ticks]) * (m.v[ticks] > 0), 0.7
    else:
        heading = m.heading[ticks]
        off = (at[0] - m.x[ticks]) * np.cos(heading) + (at[1] - m.y[ticks]) * np.sin(heading)
        error, blur = np.gradient(off, ticks / HZ), 1.5
    noise = np.interp(np.arange(len(m)), ticks, error)
    return np.maximum(m.v + gaussian_filter1d(noise, blur * HZ), 0.01) * (m.v > 0)


def _windows(
    w: World, m: Motion, vehicle: int, ticks: np.ndarray, log: dict[str, np.ndarray], truth: Motion
) -> Seen:
    out = Seen(vehicle)
    if "speed" in log:
        _distance_windows(w, truth, out, ticks, log["speed"])
    if "battery_power" in log:
        _power_windows(w, m, out, ticks, log["battery_power"])
    _charge_windows(w, m, out, ticks, log["soc"])
    return out


def _choices(w: World) -> dict[str, list[Effect]]:
    """Sets of effects that models have: all of them, none, all but each."""
    if not w.effects:
        return {"": []}
    return {"": w.effects, "*": []} | {e.term: [o for o in w.effects if o is not e] for e in w.effects}


def _tolerances(w: World) -> list[Truck]:
    return [replace(w.file, **{k: getattr(w.file, k) * (1.0 + share)}) for k, share in TOLERANCE.items()]


def _power_windows(w: World, m: Motion, out: Seen, ticks: np.ndarray, logged: np.ndarray) -> None:
    """Windows of ten seconds or five rows."""
    gap = np.gradient(ticks.astype(float)) / HZ
    size = max(10.0, 5.0 * w.logger.interval) * HZ
    hold = np.where(gap > 3.0 * w.logger.interval, 0.0, gap)
    cell = (ticks // size).astype(int)
    inside = np.nan_to_num(m.charge)[ticks] if w.logger.charging == "inside" else 0.0
    free = hold * (m.charge[ticks] == 0.0)

    def energy(effects: list[Effect], truck: Truck) -> np.ndarray:
        power = balance(m, truck, effects, out.vehicle, w.truck, weighed=True)[0]
        logger = _heard(w.logger, w, effects)
        return np.bincount(cell, reported_power(power, ticks, logger, _averaging(effects)) * free)

    out.logged["battery_power"] = np.bincount(cell, (logged + inside) * free)
    out.models["battery_power"] = {name: energy(effects, w.file) for name, effects in _choices(w).items()}
    whole = out.models["battery_power"][""]
    out.adjust["battery_power"] = np.column_stack([energy(w.effects, t) - whole for t in _tolerances(w)])


def _heard(logger: Logger, w: World, effects: list[Effect]) -> Logger:
    """The logger of a model that knows only some of the effects on its clock."""
    unknown = sum(e.parameters["offset"] for e in w.effects if e.term == "clock_offset" and e not in effects)
    return replace(logger, offset=logger.offset - unknown)


def _distance_windows(w: World, m: Motion, out: Seen, ticks: np.ndarray, speed: np.ndarray) -> None:
    """Minutes of driven distance by the speed channel, beside that by a map."""
    gap = np.gradient(ticks.astype(float)) / HZ
    cell = (ticks // (60 * HZ)).astype(int)
    out.logged["distance"] = np.bincount(cell, speed * gap)
    for name, effects in _choices(w).items():
        model = m.v[ticks] * _speed_scale(effects, m, out.vehicle)[ticks]
        out.models.setdefault("distance", {})[name] = np.bincount(cell, model * gap)
    out.adjust["distance"] = np.zeros((len(out.logged["distance"]), 0))


def _charge_windows(w: World, m: Motion, out: Seen, ticks: np.ndarray, soc: np.ndarray) -> None:
    """Windows of a minute, or long enough for fifteen steps of the state of charge at two kilowatts."""
    step = 3600.0 * w.truck.capacity * w.logger.soc_step
    size = max(60.0, 5.0 * w.logger.interval, 15.0 * step / 2000.0) * HZ
    marks = ticks[np.flatnonzero(np.diff(ticks // size, prepend=-1))]
    if len(marks) < 3:
        return
    at = np.searchsorted(ticks, marks)
    idle = np.diff(np.concatenate([[0.0], np.cumsum(m.charge != 0.0)])[marks]) == 0

    def energy(effects: list[Effect], truck: Truck) -> np.ndarray:
        cell = balance(m, truck, effects, out.vehicle, w.truck, weighed=True)[1]
        full = capacity(m, truck, effects, out.vehicle)
        total = np.concatenate([[0.0], np.cumsum(cell / full)]) / HZ * truck.capacity
        return np.diff(total[marks])[idle]

    out.logged["soc"] = -np.diff(soc[at])[idle] * 3600.0 * w.truck.capacity
    out.models["soc"] = {name: energy(effects, w.file) for name, effects in _choices(w).items()}
    whole = out.models["soc"][""]
    out.adjust["soc"] = np.column_stack([energy(w.effects, t) - whole for t in _tolerances(w)])
