"""Public logs as fleetlog reads them, each with the column that is withheld from it and the nominal vehicle.

What a vehicle weighs and how it is built comes from its maker's data sheet; what no sheet gives (rolling, efficiency, share of
braking that comes back, constant load) is a textbook figure.  Neither is fitted to the log but for the robot's one rolling
coefficient, which is the median of all its driving.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck, truck_from_dict
from fleetlog.store.trips import trip_ids

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Log:
    """``withheld`` (N,) the column that the diagnosis never sees: altitude [m], NaN where unknown, or a code of ``labels``."""

    track: Trajectory
    withheld: Floats
    truck: Truck
    frame: Frame | None = None
    labels: tuple[str, ...] = ()
    holdout: str = "trips"


# Nissan Leaf of 40 kWh: kerb mass 1580 kg and a driver, c_d 0.28 on 2.28 m2, 350 V, 39 kWh usable.  Of the two batteries that the
# maker sold it is the smaller: the log spends 20 kWh on 53 % of charge.
LEAF = truck_from_dict({
    "name": "electric hatchback", "chassis": {"mass": 1655.0, "rated_load": 0.0}, "drive": {"efficiency": 0.85, "regeneration": 0.65, "max_speed": 40.0},
    "resistance": {"rolling": 0.010, "drag_area": 0.64}, "auxiliary": {"power": 600.0}, "battery": {"voltage": 350.0, "capacity_wh": 39000.0},
})  # fmt: skip
# Renault Twizy 80: kerb mass 474 kg and a driver, c_d A 0.64 m2, 58 V, 6.1 kWh.
TWIZY = truck_from_dict({
    "name": "quadricycle", "chassis": {"mass": 549.0, "rated_load": 0.0}, "drive": {"efficiency": 0.78, "regeneration": 0.35, "max_speed": 23.0},
    "resistance": {"rolling": 0.014, "drag_area": 0.64}, "auxiliary": {"power": 150.0}, "battery": {"voltage": 58.0, "capacity_wh": 6100.0},
})  # fmt: skip
# Clearpath Husky: 50 kg and some 25 kg of sensors, 24 V, 1 m/s.
HUSKY = {
    "name": "skid-steer robot", "chassis": {"mass": 75.0, "rated_load": 0.0}, "drive": {"efficiency": 1.0, "regeneration": 0.0, "max_speed": 1.0},
    "auxiliary": {"power": 0.0}, "battery": {"voltage": 24.0, "capacity_wh": 480.0},
}  # fmt: skip
# A road bicycle and its rider, 84 kg: textbook rolling and drag; a chain returns nothing.
BICYCLE = truck_from_dict({
    "name": "bicycle", "chassis": {"mass": 84.0, "rated_load": 0.0}, "drive": {"efficiency": 0.98, "regeneration": 0.0, "max_speed": 22.0},
    "resistance": {"rolling": 0.005, "drag_area": 0.35}, "auxiliary": {"power": 0.0}, "battery": {"voltage": 36.0, "capacity_wh": 500.0},
})  # fmt: skip
# An e-scooter of 20 kg and its rider, 36 V, 460 Wh.
SCOOTER = truck_from_dict({
    "name": "e-scooter", "chassis": {"mass": 105.0, "rated_load": 0.0}, "drive": {"efficiency": 0.75, "regeneration": 0.0, "max_speed": 8.0},
    "resistance": {"rolling": 0.012, "drag_area": 0.6}, "auxiliary": {"power": 5.0}, "battery": {"voltage": 36.0, "capacity_wh": 460.0},
})  # fmt: skip
STRAIGHT = 0.05
"""Difference of the wheels' speeds at which a robot that steers by it drives straight [m/s]."""
SLOWEST = 0.1
"""Below this wheel speeds are too coarse [m/s]."""


def tripviewer(data: Path) -> Log:
    """One motorway run of 140 km at 5 s; withheld is the log's elevation [ft]."""
    tidy = data / "tripviewer" / "tripviewer_hesperia_la.csv"
    t = pd.read_csv(tidy) if tidy.exists() else leafspy(data / "tripviewer" / "Log.csv")
    t = t.drop_duplicates("epoch")
    frame = Frame(float(t.lat.mean()), float(t.lon.mean()))
    x, y = frame.to_local(t.lat.to_numpy(), t.lon.to_numpy())
    columns = _moving(x, y, t.speed_mph.to_numpy() * 0.44704) | {
        "battery_power": (t.volts * t.amps).to_numpy(float), "soc": t.soc.to_numpy(float) / 100.0,
        "ambient_temperature": (t.amb_f.to_numpy(float) - 32.0) / 1.8,
    }  # fmt: skip
    time = (t.epoch.to_numpy() * 1e6).astype(np.int64)
    return Log(Trajectory("leaf", time, columns), t.elev_ft.to_numpy() * 0.3048, LEAF, frame)


def twizy(data: Path) -> Log:
    """Eleven runs on three routes at 1 Hz, energy from the state of charge; positions as logged, held from one update to the next.

    Withheld is the receiver's altitude, a whole number of metres that is 0 or -111 where it is unknown.
    """
    frame, runs = Frame(33.98, -6.75), []
    for file in sorted((data / "twizy").glob("T*/*.csv")):
        run = pd.read_csv(file)
        stamp = pd.to_datetime(
            run.Date + " " + run.Time, format="%m/%d/%Y %H:%M:%S", utc=True, errors="coerce"
        )
        runs.append(run.assign(us=stamp.astype("datetime64[us, UTC]").astype(np.int64))[stamp.notna()])
    t = pd.concat(runs).sort_values("us").drop_duplicates("us")
    near = (t.LAT.sub(33.98).abs() < 0.5) & (t.LON.add(6.75).abs() < 0.5)
    x, y = frame.to_local(t.LAT.where(near).to_numpy(), t.LON.where(near).to_numpy())
    columns = _moving(x, y, t.Speed.to_numpy() / 3.6) | {
        "soc": t.Soc.to_numpy(float) / 100.0, "ambient_temperature": t.Temperature.to_numpy(float),
    }  # fmt: skip
    known = (t.ALT > -50) & (t.ALT != 0)
    track = Trajectory("twizy", t.us.to_numpy(), columns)
    return Log(track, t.ALT.where(known).to_numpy(float), TWIZY, frame, holdout="days")


def borealtc(data: Path) -> Log:
    """A robot on several surfaces where it drives straight, every run a trip; withheld is the surface.

    The log has no clock that all runs share: each is given an hour of its own, in an order that says nothing of the surface.
    """
    tidy = data / "borealtc" / "borealtc_husky_6hz.csv.gz"
    t = pd.read_csv(tidy) if tidy.exists() else proprioception(data / "borealtc" / "borealtc-data")
    key = t.terrain + t.run.astype(str)
    names = np.unique(key)
    hour = dict(zip(names, np.random.default_rng(0).permutation(len(names)).tolist(), strict=True))
    t = t.assign(trip=key.map(hour), speed=(t.velL_mps + t.velR_mps).abs() / 2.0)
    t["us"] = ((1_650_000_000 + 3600 * t.trip + t.t_s) * 1e6).astype(np.int64)
    t = t[((t.velL_mps - t.velR_mps).abs() < STRAIGHT) & (t.speed > SLOWEST)]
    t = t.sort_values("us").drop_duplicates("us")
    speed = t.speed.to_numpy(float)
    # Electromagnetic power of both motors: current times the voltage that their speed induces, 24 V at 1 m/s.
    power = 24.0 * speed * (t.curL_A.abs() + t.curR_A.abs()).to_numpy(float)
    track = Trajectory("husky", t.us.to_numpy(), {
        "speed": speed, "battery_power": power, "trip_id": t.trip.to_numpy(np.int64),
    })  # fmt: skip
    code, labels = pd.factorize(t.terrain, sort=True)
    rolling = float(np.median(power / speed)) / (9.81 * HUSKY["chassis"]["mass"])
    truck = truck_from_dict({**HUSKY, "resistance": {"rolling": rolling}})
    return Log(track, code.astype(float), truck, labels=tuple(labels))


def bike(data: Path) -> Log:
    """Four rides with a power meter at 1 Hz, no position; withheld is the slope [1], which is no altitude."""
    t = pd.read_csv(data / "bike" / "bike_rides.csv.gz").drop_duplicates("timestamp")
    time = pd.to_datetime(t.timestamp, utc=True).astype("datetime64[us, UTC]").astype(np.int64)
    columns = {"speed": t.speed.to_numpy(float), "battery_power": t.power.to_numpy(float)}
    return Log(Trajectory("bicycle", time.to_numpy(), columns), t.slope.to_numpy(float), BICYCLE)


def escooter(data: Path) -> Log:
    """Thirty trips about one campus, a row every 12 s, energy from a state of charge in whole per cent."""
    runs = [pd.read_csv(file) for file in sorted((data / "escooter").glob("trip_*.csv"))]
    t = pd.concat(runs).assign(
        us=lambda t: pd.to_datetime(t.Timestamp, utc=True).astype("datetime64[us, UTC]")
    )
    t = t.assign(lat=pd.to_numeric(t.Latitude, errors="coerce")).dropna(subset="lat")
    t = t.sort_values("us").drop_duplicates("us")
    frame = Frame(float(t.lat.mean()), float(t.Longitude.mean()))
    x, y = frame.to_local(t.lat.to_numpy(), t.Longitude.to_numpy())
    columns = _moving(x, y, t.Speed.to_numpy(float) / 3.6) | {"soc": t.SoC.to_numpy(float) / 100.0}
    track = Trajectory("escooter", t.us.astype(np.int64).to_numpy(), columns)
    return Log(track, t.Altitude.to_numpy(float), SCOOTER, frame)


READERS = {f.__name__: f for f in (tripviewer, twizy, borealtc, bike, escooter)}


def poorer(log: Log, lack: str) -> Log:
    """A log as a poorer recorder has it: ``uneven`` (3 to 7 s between rows, or every row or every second where
    rows are 5 s apart), ``fifth`` (every fifth row) or ``half`` (every second trip; of one trip, the first half)."""
    rng, time = np.random.default_rng(0), log.track.time
    trips = log.track.trip_ids() if log.track.has("trip_id") else trip_ids(log.track)
    if lack == "fifth":
        rows = np.arange(0, len(time), 5)
    elif lack == "half":
        several = len(np.unique(trips)) > 1
        rows = np.flatnonzero(trips % 2 == 0) if several else np.arange(len(time) // 2)
    else:
        step = float(np.median(np.diff(time))) * 1e-6
        most = max(2, round(7.0 / step))
        rows = np.cumsum(rng.integers(max(1, round(3.0 / step)), most, len(time), endpoint=most > 2))
        rows = rows[rows < len(time)]
    return replace(log, track=log.track[rows], withheld=log.withheld[rows])


def leafspy(path: Path) -> pd.DataFrame:
    """``examples/Log.csv`` of TripViewer as published: degrees and minutes, state of charge in millionths."""
    t = pd.read_csv(path, index_col=False)

    def degrees(column: str) -> pd.Series:
        whole, minutes = t[column].str.split(" ").str[0], t[column].str.split(" ").str[1].astype(float)
        return whole.astype(float) + np.where(whole.str.startswith("-"), -1.0, 1.0) * minutes / 60.0

    return pd.DataFrame({
        "epoch": t["epoch time"].astype(float), "lat": degrees("Lat"), "lon": degrees("Long"), "elev_ft": t["Elv"].astype(float),
        "speed_mph": t["Speed"].astype(float), "soc": t["SOC"].astype(float) * 1e-4, "volts": t["Pack Volts"].astype(float),
        "amps": t["Pack Amps"].astype(float), "amb_f": t["Ambient"].astype(float),
    })  # fmt: skip


def proprioception(folder: Path) -> pd.DataFrame:
    """``borealtc-data/SURFACE/pro_NN.csv`` of BorealTC as published, all runs in one table."""
    runs = [
        pd.read_csv(path).assign(terrain=path.parent.name, run=int(path.stem.removeprefix("pro_")))
        for path in sorted(folder.glob("*/pro_*.csv"))
    ]
    names = {"time": "t_s", "curL": "curL_A", "curR": "curR_A", "velL": "velL_mps", "velR": "velR_mps"}
    return pd.concat(runs, ignore_index=True).rename(columns=names)


def _moving(x: Floats, y: Floats, speed: Floats) -> dict[str, Floats]:
    a, b = np.maximum(np.arange(len(x)) - 2, 0), np.minimum(np.arange(len(x)) + 2, len(x) - 1)
    return {"x": x, "y": y, "speed": speed, "heading": np.arctan2(y[b] - y[a], x[b] - x[a])}
