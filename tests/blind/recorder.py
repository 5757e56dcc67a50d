"""A recorder for blind tests: a plant, trucks and drivers at 20 Hz, sampled and blurred into a raw log, with a sealed key.

It shares no code with the model that it tests: another integrator, another rounding of corners, drivers who differ and are
slowed by others at random, loads that are mis-weighed, trucks that differ, power that is filtered, quantised and noisy.

    python recorder.py TERM[+TERM] SEED FOLDER        TERM of effects.TERMS, effects.OUTSIDE, or none
"""

from __future__ import annotations

import gzip
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from effects import draw, truck
from numba import njit
from plants import STEP, Plant

HZ = 20
GRAVITY, AIR = 9.81, 1.2
LATITUDE, LONGITUDE = 49.97, 9.15
METRE, METRE_EAST = 1.0 / 111_229.0, 1.0 / 71_740.0
"""Degrees per metre of the ellipsoid there, north and east."""


@njit(cache=True)
def _advance(
    cap: np.ndarray, step: np.ndarray, up: float, down: float, wait_at: int, wait: float, jerk: float
) -> tuple[np.ndarray, np.ndarray]:
    """Speed and index along the path at every tick: a driver who looks ahead, with limited jerk."""
    speeds, places = [], []
    n, dt = len(cap), 0.05
    ahead = np.empty(n)
    ahead[n - 1] = 0.0
    for i in range(n - 2, -1, -1):
        ahead[i] = min(cap[i], np.sqrt(ahead[i + 1] ** 2 + 2.0 * down * step[i]))
    s, v, a, i, waited, tick = 0.0, 0.0, 0.0, 0, False, 0
    position = np.cumsum(step)
    while i < n - 2 and tick < 200000:
        tick += 1
        look = min(int(i + 1 + v * 0.25 / 0.1), n - 1)
        goal = ahead[look]
        wish = min(max((goal - v) / 0.35, -1.25 * down), up)
        a += min(max(wish - a, -jerk * dt), jerk * dt)
        v = max(v + a * dt, 0.0)
        if v < 0.12 and goal > 0.12:
            v = 0.12
        if i > n - 8 and v < 0.3:
            break
        v = max(v, 0.12)
        s += v * dt
        while i < n - 1 and position[i] < s:
            i += 1
        speeds.append(v)
        places.append(i)
        if not waited and wait_at >= 0 and i >= wait_at:
            waited = True
            down_steps = int(v / 0.8 / dt)
            for k in range(down_steps):
                speeds.append(v * (1.0 - (k + 1) / down_steps))
                places.append(i)
            for _ in range(int(wait / dt)):
                speeds.append(0.0)
                places.append(i)
            v, a = 0.0, 0.0
    return np.array(speeds), np.array(places)


def record(
    name: str,
    seed: int,
    folder: Path,
    strength: float = 1.0,
    vehicles: int = 4,
    hours: float = 2.5,
    days: int = 1,
    given: dict[str, Any] | None = None,
) -> None:
    """Write ``recorded.csv.gz``, ``roads.geojson``, ``site.toml``, ``truck.toml`` and ``key.json``.

    ``given`` effects take the place of those drawn under their names.
    """
    rng = np.random.default_rng(seed)
    plant, nominal = Plant(rng), truck(rng)
    names = [] if name == "none" else name.split("+")
    # Drawn apart, so that the clean recording of a seed has the same drives.
    drawn = np.random.default_rng([seed, 1])
    effects = {n: draw(n, plant, nominal, strength, drawn) for n in names} | (given or {})
    if "grade" in effects:
        effects["grade"]["max_grade"] = plant.steepest(effects["grade"])
    if "wind" in effects:
        nominal["drag_area"] = 6.0
    folder.mkdir(parents=True, exist_ok=True)
    _write_site(plant, nominal, folder)
    trucks: list[dict[str, float]] = [{} for _ in range(vehicles)]
    rows = [
        row
        for day in range(days)
        for k in range(vehicles)
        for row in _vehicle(plant, nominal, effects, k, trucks[k], hours, day, rng)
    ]
    rows.sort(key=lambda r: r[1])
    header = "vehicle_id,timestamp,latitude,longitude,speed,payload,fork_height,battery_power,soc,ambient_temperature"
    with gzip.open(folder / "recorded.csv.gz", "wt", encoding="utf-8") as out:
        out.write(header + "\n")
        for r in rows:
            stamp = np.datetime64("2026-04-13T06:00:00", "ms") + np.timedelta64(int(r[1] * 1000), "ms")
            out.write(
                f"{r[0]},{stamp}Z,"
                + ",".join(f"{v:.{d}f}" for v, d in zip(r[2:], (8, 8, 3, 0, 2, 1, 5, 1), strict=True))
                + "\n"
            )
    roads = sorted(
        {f"r{k:02d}" for e in effects.values() for k in e.get("roads", [e["road"]] if "road" in e else [])}
    )
    key = {
        "terms": names,
        "where": roads,
        "seed": seed,
        "strength": strength,
        "effect": effects,
        "rows": len(rows),
    }
    (folder / "key.json").write_text(json.dumps(key, indent=1))


def _write_site(plant: Plant, nominal: dict[str, float], folder: Path) -> None:
    features = []
    for k, (a, b) in enumerate(plant.ends):
        line = [
            [round(LONGITUDE + x * METRE_EAST, 9), round(LATITUDE + y * METRE, 9)] for x, y in plant.line(k)
        ]
        properties = {
            "id": f"r{k:02d}",
            "from": f"j{a}",
            "to": f"j{b}",
            "oneway": bool(plant.oneway[k]),
            "speed_limit": float(plant.limit[k]),
        }
        features.append(
            {
                "type": "Feature",
                "properties": properties,
                "geometry": {"type": "LineString", "coordinates": line},
            }
        )
    (folder / "roads.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    (folder / "site.toml").write_text(
        f'name = "yard"\n[frame]\nlatitude = {LATITUDE}\nlongitude = {LONGITUDE}\n[network]\nfile = "roads.geojson"\n'
    )
    t = nominal
    (folder / "truck.toml").write_text(
        f'name = "blind"\n[chassis]\nmass = {t["mass"]}\nturn_radius = {t["radius"]}\n[drive]\nefficiency = {t["efficiency"]}\n'
        f"regeneration = {t['regeneration']}\nspeed_factor = {t['factor']}\nmax_acceleration = {t['acceleration']}\n"
        f"max_deceleration = {t['deceleration']}\nmax_lateral_acceleration = {t['lateral']}\n[resistance]\nrolling = {t['rolling']}\n"
        f"drag_area = {t['drag_area']}\n[lift]\nefficiency = {t['lift']}\ncarriage_mass = {t['carriage']}\n[auxiliary]\npower = {t['power']}\n"
        f"[battery]\nvoltage = {t['voltage']}\ncapacity_wh = {t['capacity']}\n"
    )


def _vehicle(
    plant: Plant,
    t: dict[str, float],
    effects: dict[str, Any],
    number: int,
    own: dict[str, float],
    hours: float,
    day: int,
    rng: np.random.Generator,
) -> list[tuple[Any, ...]]:
    """Rows of one truck on one day: trips with and without a load, lifting at their ends; its ``own`` numbers stay."""
    own |= own or {
        "mass": t["mass"] * (1 + 0.008 * rng.normal()), "rolling": t["rolling"] * (1 + 0.025 * rng.normal()),
        "power": t["power"] * (1 + 0.03 * rng.normal()), "efficiency": t["efficiency"] * (1 + 0.004 * rng.normal()),
    }  # fmt: skip
    driver = {
        k: 1 + s * rng.normal() for k, s in (("pace", 0.015), ("up", 0.04), ("down", 0.06), ("turn", 0.05))
    }
    place, loaded, pieces, clock = int(rng.integers(len(plant.xy))), False, [], 0.0
    while clock < hours * 3600.0:
        goal = int(rng.integers(len(plant.xy)))
        legs = plant.route(place, goal, rng) if goal != place else []
        if not legs:
            continue
        path = plant.path(legs)
        load = float(rng.uniform(300, 2400)) if loaded else 0.0
        piece = _trip(plant, path, t, effects, driver, load, rng)
        lifted = _lift(piece, float(rng.uniform(0.3, 3.4)), rng)
        pieces.append(lifted)
        clock += len(lifted["v"]) / HZ
        place, loaded = goal, not loaded if rng.random() < 0.9 else loaded
    whole = {k: np.concatenate([p[k] for p in pieces]) for k in pieces[0]}
    return _rows(whole, t, own, effects, number, day, rng)


def _trip(
    plant: Plant,
    path: dict[str, np.ndarray],
    t: dict[str, float],
    effects: dict[str, Any],
    driver: dict[str, float],
    load: float,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    allowed = plant.limit[path["road"]] * t["factor"] * driver["pace"]
    if "speed_zone" in effects:
        allowed = np.where(
            np.isin(path["road"], effects["speed_zone"]["roads"]),
            effects["speed_zone"]["factor"] * allowed,
            allowed,
        )
    if "laden_speed" in effects and load > 0:
        allowed = allowed * effects["laden_speed"]["factor"]
    lateral = effects.get("cornering_speed", {}).get("lateral_acceleration", t["lateral"]) * driver["turn"]
    cap = np.minimum(np.minimum(allowed, 5.0), np.sqrt(lateral / np.maximum(np.abs(path["bend"]), 1e-4)))
    # Others in the way: now and then a stretch is driven more slowly.
    for _ in range(rng.poisson(len(cap) * STEP / 400.0)):
        at, long = int(rng.integers(len(cap))), int(rng.uniform(50, 200))
        cap[at : at + long] *= rng.uniform(0.6, 0.95)
    up = effects.get("acceleration_limit", {}).get("acceleration", t["acceleration"]) * driver["up"]
    wait_at, wait = -1, 0.0
    if "waiting" in effects:
        e = effects["waiting"]
        on = np.flatnonzero((path["road"] == e["road"]) & (path["sense"] == e["sense"]))
        if len(on) > 20:
            wait_at, wait = int(on[int(e["at"] * len(on))]), e["seconds"] * rng.uniform(0.7, 1.3)
    v, i = _advance(
        np.maximum(cap, 0.4), path["step"], up, t["deceleration"] * driver["down"], wait_at, wait, 3.0
    )
    out = {k: path[k][i] for k in ("x", "y", "heading", "bend", "road", "sense")}
    weighed = max(load * (1 + 0.03 * rng.normal()), 0.0)
    out.update(
        v=v,
        load=np.full(len(v), load),
        weighed=np.full(len(v), weighed),
        height=np.zeros(len(v)),
        lift=np.zeros(len(v)),
    )
    return out


def _lift(trip: dict[str, np.ndarray], height: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The standstill after a trip: up, a pause, down."""
    up, down = int(height / 0.35 * HZ), int(height / 0.45 * HZ)
    rest = [int(rng.uniform(4, 15) * HZ) for _ in range(3)]
    rate = np.concatenate(
        [np.zeros(rest[0]), np.full(up, 0.35), np.zeros(rest[1]), np.full(down, -0.45), np.zeros(rest[2])]
    )
    n = len(rate)
    out = {
        k: np.concatenate([v, np.full(n, v[-1] if k not in ("v", "bend") else 0.0)]) for k, v in trip.items()
    }
    out["lift"][-n:] = rate
    out["height"][-n:] = np.maximum(np.cumsum(rate) / HZ, 0.0)
    return out


def _rows(
    w: dict[str, np.ndarray],
    t: dict[str, float],
    own: dict[str, float],
    effects: dict[str, Any],
    number: int,
    day: int,
    rng: np.random.Generator,
) -> list[tuple[Any, ...]]:
    n = len(w["v"])
    clock = np.arange(n) / HZ
    start = float(rng.uniform(0, 240))
    warmer = float(rng.uniform(-4.0, 12.0)) if day else 0.0
    temperature = warmer - 1.0 + 2.6 * (clock + start) / 3600.0 + 0.2 * np.sin(clock / 700.0)
    power, cell = _power(w, t, own, effects, number, clock, temperature)
    # The logger's filter, then noise in proportion and white.
    smooth = np.convolve(power, np.ones(4) / 4.0)[:n]
    pick = np.arange(HZ // 2, n, HZ)
    shift = effects.get("clock_offset", {}).get("offset", 0.0)
    seen = np.interp(pick - shift * HZ, np.arange(n), np.convolve(smooth, np.ones(HZ) / HZ, "same"))
    seen = seen * (1 + 0.01 * rng.normal(size=len(pick))) + 30.0 * rng.normal(size=len(pick))
    speed = np.convolve(w["v"], np.ones(HZ) / HZ, "same")[pick] * effects.get("speed_scale", {}).get(
        "factor", 1.0
    )
    speed = np.where(w["v"][pick] <= 0, 0.0, np.maximum(speed + 0.03 * rng.normal(size=len(pick)), 0.0))
    drift = [_wander(len(pick), 0.25, rng) for _ in range(2)]
    x, y = w["x"][pick] + drift[0], w["y"][pick] + drift[1]
    soc = 0.97 - np.cumsum(cell) / HZ / (3600.0 * t["capacity"])
    keep = rng.random(len(pick)) > 0.004
    return [
        (f"T{number + 1}", 86400.0 * day + start + clock[p], LATITUDE + b * METRE, LONGITUDE + a * METRE_EAST, s, m, h, e, q, c)
        for p, a, b, s, m, h, e, q, c, k in zip(
            pick, x, y, speed, w["weighed"][pick], w["height"][pick], seen, soc[pick], temperature[pick], keep, strict=True
        )
        if k
    ]  # fmt: skip


def _wander(n: int, size: float, rng: np.random.Generator) -> np.ndarray:
    """Position noise that wanders over half a minute."""
    from scipy.signal import lfilter

    return lfilter([np.sqrt(1 - 0.96**2)], [1.0, -0.96], size * rng.normal(size=n))


def _power(
    w: dict[str, np.ndarray],
    t: dict[str, float],
    own: dict[str, float],
    effects: dict[str, Any],
    number: int,
    clock: np.ndarray,
    temperature: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(terminal, cell) power at every tick [W]."""
    v, n = w["v"], len(w["v"])
    a = np.gradient(v) * HZ
    value = lambda term, name, other: effects.get(term, {}).get(name, other)
    load = w["load"] * value("payload", "factor", 1.0)
    mass = own["mass"] + load
    rolling = (
        own["rolling"] * value("rolling_resistance", "coefficient", t["rolling"]) / t["rolling"] * np.ones(n)
    )
    if "surface_resistance" in effects:
        rolling = (
            rolling
            + np.isin(w["road"], effects["surface_resistance"]["roads"])
            * (effects["surface_resistance"]["factor"] - 1)
            * t["rolling"]
        )
    if "warm_up" in effects:
        rolling = rolling * (
            1 + effects["warm_up"]["share"] * np.exp(-clock / 60.0 / effects["warm_up"]["minutes"])
        )
    force = mass * a * value("rotational_inertia", "factor", 1.0) + rolling * mass * GRAVITY * (v > 0)
    if "grade" in effects:
        e = effects["grade"]
        dx, dy = w["x"] - e["x"], w["y"] - e["y"]
        hill = e["height"] * np.exp(-(dx**2 + dy**2) / e["width"] ** 2)
        slope = -2.0 * hill / e["width"] ** 2 * (dx * np.cos(w["heading"]) + dy * np.sin(w["heading"]))
        force = force + mass * GRAVITY * np.sin(np.arctan(slope))
    area = value("aerodynamic_drag", "drag_area", t["drag_area"])
    along = 0.0
    if "wind" in effects:
        gust = 1.0 + 0.1 * np.sin(clock / 90.0)
        along = effects["wind"]["speed"] * gust * np.cos(w["heading"] - effects["wind"]["angle"])
    force = force + 0.5 * AIR * area * (v - along) * np.abs(v - along)
    force = force + value("cornering_resistance", "k", 0.0) * mass * GRAVITY * np.abs(w["bend"]) * (v > 0)
    force = force + value("viscous_drag", "coefficient", 0.0) * v
    if number == value("odd_vehicle", "vehicle", -1):
        force = force + effects["odd_vehicle"]["force"] * (v > 0)
    mechanical = force * v
    efficiency = (
        own["efficiency"] * value("drivetrain_efficiency", "efficiency", t["efficiency"]) / t["efficiency"]
    )
    drive = np.where(
        mechanical > 0,
        mechanical / efficiency,
        mechanical * value("regeneration", "regeneration", t["regeneration"]),
    )
    if "low_charge" in effects:
        drive = drive * (
            1 + np.where(drive > 0, effects["low_charge"]["share"] * np.clip(clock / 9000.0, 0, 1) ** 2, 0.0)
        )
    lifting = (
        (load + t["carriage"])
        * GRAVITY
        * np.maximum(w["lift"], 0.0)
        / value("lift_efficiency", "efficiency", t["lift"])
    )
    power = drive + lifting + own["power"] + value("auxiliary_load", "power", t["power"]) - t["power"]
    if "thermal_load" in effects:
        power = power + effects["thermal_load"]["heating"] * np.maximum(
            effects["thermal_load"]["threshold"] - temperature, 0.0
        )
    if "hour" in effects:
        h = clock / 3600.0 - effects["hour"]["from"]
        power = power + effects["hour"]["power"] * ((h > 0) & (h < effects["hour"]["hours"]))
    if "laden_fast" in effects:
        power = power + effects["laden_fast"]["power"] * (load > 800) * np.clip(v - 2.2, 0, 1.5)
    loss = value("battery_resistance", "resistance", 0.0) * (power / t["voltage"]) ** 2
    return power, power + loss


if __name__ == "__main__":
    record(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
