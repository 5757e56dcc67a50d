"""Real logs with the column that explains them withheld, diagnosed, and judged against that column afterwards.

    python tests/proofs/hidden_column.py tripviewer|twizy|borealtc DATA OUT

DATA is the folder of public logs (see docs/proof.md for where they come from).  The altitude, or the surface, is never
written into the dataset that ``fleetlog diagnose`` reads; this script alone looks at it, at the end.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from fleetlog.core.site import Frame, Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck, truck_from_dict
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.output import lines, write_diagnosis
from fleetlog.discovery.squares import Squares
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids

LEAF = truck_from_dict({
    "name": "electric hatchback", "chassis": {"mass": 1655.0}, "drive": {"efficiency": 0.85, "regeneration": 0.65, "max_speed": 40.0},
    "resistance": {"rolling": 0.010, "drag_area": 0.64}, "auxiliary": {"power": 600.0}, "battery": {"voltage": 350.0, "capacity_wh": 39000.0},
})  # fmt: skip
TWIZY = truck_from_dict({
    "name": "quadricycle", "chassis": {"mass": 540.0}, "drive": {"efficiency": 0.78, "regeneration": 0.35, "max_speed": 23.0},
    "resistance": {"rolling": 0.014, "drag_area": 0.64}, "auxiliary": {"power": 150.0}, "battery": {"voltage": 58.0, "capacity_wh": 6100.0},
})  # fmt: skip
HUSKY = {
    "name": "skid-steer robot", "chassis": {"mass": 75.0}, "drive": {"efficiency": 1.0, "regeneration": 0.0, "max_speed": 1.0},
    "auxiliary": {"power": 0.0}, "battery": {"voltage": 24.0, "capacity_wh": 480.0},
}  # fmt: skip


def tripviewer(data: Path) -> tuple[list[tuple[Trajectory, np.ndarray]], Frame | None, Truck]:
    """One motorway run; altitude from the log's own elevation [ft]."""
    t = pd.read_csv(data / "tripviewer" / "tripviewer_hesperia_la.csv").drop_duplicates("epoch")
    frame = Frame(float(t.lat.mean()), float(t.lon.mean()))
    x, y = frame.to_local(t.lat.to_numpy(), t.lon.to_numpy())
    columns = _columns(x, y, t.speed_mph.to_numpy() * 0.44704) | {
        "battery_power": (t.volts * t.amps).to_numpy(float), "soc": t.soc.to_numpy(float) / 100.0,
        "ambient_temperature": (t.amb_f.to_numpy(float) - 32.0) / 1.8,
    }  # fmt: skip
    time = (t.epoch.to_numpy() * 1e6).astype(np.int64)
    return [(Trajectory("leaf", time, columns), t.elev_ft.to_numpy() * 0.3048)], frame, LEAF


def twizy(data: Path) -> tuple[list[tuple[Trajectory, np.ndarray]], Frame | None, Truck]:
    """Three routes, eleven runs, of one vehicle; positions as logged, held from one update of the receiver to the next."""
    frame, out = Frame(33.98, -6.75), []
    for file in sorted((data / "twizy").glob("T*/*.csv")):
        t = pd.read_csv(file)
        stamp = pd.to_datetime(t.Date + " " + t.Time, format="%m/%d/%Y %H:%M:%S", utc=True, errors="coerce")
        t = t.assign(us=stamp.astype("datetime64[us, UTC]").astype(np.int64))[stamp.notna()]
        out.append(t.drop_duplicates("us"))
    t = pd.concat(out).sort_values("us").drop_duplicates("us")
    here = (t.LAT.sub(33.98).abs() < 0.5) & (t.LON.add(6.75).abs() < 0.5)
    x, y = frame.to_local(t.LAT.where(here).to_numpy(), t.LON.where(here).to_numpy())
    columns = _columns(x, y, t.Speed.to_numpy() / 3.6) | {
        "soc": t.Soc.to_numpy(float) / 100.0, "ambient_temperature": t.Temperature.to_numpy(float),
    }  # fmt: skip
    altitude = t.ALT.where(t.ALT > -100).to_numpy()
    return [(Trajectory("twizy", t.us.to_numpy(), columns), altitude)], frame, TWIZY


def borealtc(data: Path) -> tuple[list[tuple[Trajectory, np.ndarray]], Frame | None, Truck]:
    """A robot on several surfaces, straight driving, every run a trip; in an order that says nothing of the surface."""
    t = pd.read_csv(data / "borealtc" / "borealtc_husky_6hz.csv.gz")
    names = sorted({f"{terrain}-{run}" for terrain, run in zip(t.terrain, t.run, strict=True)})
    order = np.random.default_rng(0).permutation(len(names))
    rows = []
    for (terrain, run), g in t.groupby(["terrain", "run"], sort=True):
        number = int(order[names.index(f"{terrain}-{run}")])
        g = g.sort_values("t_s").drop_duplicates("t_s")
        straight = (g.velL_mps - g.velR_mps).abs() < 0.05
        g = g[straight & ((g.velL_mps + g.velR_mps).abs() > 0.2)]
        rows.append(
            g.assign(trip=number, us=((1_650_000_000 + 3600 * number + g.t_s) * 1e6).astype(np.int64))
        )
    g = pd.concat(rows).sort_values("us")
    speed = ((g.velL_mps + g.velR_mps).abs() / 2.0).to_numpy()
    # Electromagnetic power of both motors: current times the voltage that a speed induces, 24 V at 1 m/s.
    power = 24.0 * speed * (g.curL_A.abs() + g.curR_A.abs()).to_numpy()
    columns = {"speed": speed, "battery_power": power, "trip_id": g.trip.to_numpy(np.int64)}
    label = pd.factorize(g.terrain, sort=True)[0].astype(float)
    weight = 9.81 * HUSKY["chassis"]["mass"]
    husky = truck_from_dict({**HUSKY, "resistance": {"rolling": float(np.median(power / speed) / weight)}})
    return [(Trajectory("husky", g.us.to_numpy(), columns), label)], None, husky


def _columns(x: np.ndarray, y: np.ndarray, speed: np.ndarray) -> dict[str, np.ndarray]:
    a, b = np.maximum(np.arange(len(x)) - 2, 0), np.minimum(np.arange(len(x)) + 2, len(x) - 1)
    return {"x": x, "y": y, "speed": speed, "heading": np.arctan2(y[b] - y[a], x[b] - x[a])}


def run(name: str, data: Path, out: Path) -> None:
    """Write the dataset without the column, diagnose it, and look at the column."""
    pieces, frame, truck = {"tripviewer": tripviewer, "twizy": twizy, "borealtc": borealtc}[name](data)
    with DatasetWriter.create(out / f"{name}_data", "recorded", Site(name, frame), overwrite=True) as writer:
        for trajectory, _ in pieces:
            writer.write(
                trajectory
                if trajectory.has("trip_id")
                else trajectory.with_columns(trip_id=trip_ids(trajectory))
            )
    d = diagnose(Dataset(out / f"{name}_data"), truck, holdout="days" if name == "twizy" else "trips")
    folder = out / f"{name}_diagnosis"
    folder.mkdir(exist_ok=True)
    write_diagnosis(d, folder)
    print("\n".join(lines(d)))
    for channel in d.channels.values():
        print("\n".join(channel.state.log))
    judge = {"borealtc": by_surface}.get(name)
    verdict = judge(d) if judge else by_altitude(d, [t for t, _ in pieces], [z for _, z in pieces])
    print(json.dumps(verdict, indent=1))
    (out / f"{name}.json").write_text(json.dumps(verdict, indent=1))


def by_altitude(d: Diagnosis, tracks: list[Trajectory], altitudes: list[np.ndarray]) -> dict[str, object]:
    """The slope field found against the slope of the withheld altitude, over half-kilometre pieces of road."""
    channel = next((c for c in d.channels.values() if "grade" in c.result.fields), None)
    if channel is None:
        return {"grade": "not found"}
    cells, values = channel.task.floor, channel.result.fields["grade"]
    assert isinstance(cells, Squares)
    found, true, weight = [], [], []
    for track, z in zip(tracks, altitudes, strict=True):
        x, y, v, t = track.floats("x"), track.floats("y"), track.floats("speed"), track.seconds()
        s = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
        number, heading = cells.number(x, y), track.floats("heading")
        field = values.deviation.reshape(-1, 2)[np.maximum(number, 0)]
        slope = np.where(number >= 0, field[:, 0] * np.cos(heading) + field[:, 1] * np.sin(heading), np.nan)
        for a in np.arange(0.0, s[-1] - 500.0, 500.0):
            i, j = np.searchsorted(s, [a, a + 500.0])
            if j - i > 3 and np.isfinite(slope[i:j]).all():
                found.append(float(np.average(slope[i:j], weights=np.maximum(v[i:j], 0.1))))
                true.append(float((z[j] - z[i]) / (s[j] - s[i])))
                weight.append(j - i)
    f, g = np.array(found), np.array(true)
    return {
        "pieces": len(f), "correlation": float(np.corrcoef(f, g)[0, 1]), "slope of found over true": float((f * g).sum() / (g * g).sum()),
        "rms error": float(np.sqrt(np.mean((f - g) ** 2))), "rms true slope": float(np.sqrt(np.mean(g**2))),
    }  # fmt: skip


def by_surface(d: Diagnosis) -> dict[str, object]:
    """What was found to differ by run, averaged by the surface that was withheld."""
    channel = d.channels["battery_power"]
    return {
        "findings": [f.document() for f in d.verdict.findings],
        "runs": list(d.fleet.vehicles),
        "log": channel.state.log,
    }


if __name__ == "__main__":
    run(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
