"""A charging plan tried out in the simulator: the same tasks with the present chargers and with the planned ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fleetlog.core.site import Place, Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.simulate.dispatch import Policy
from fleetlog.simulate.engine import DEFAULT_START, Settings, simulate
from fleetlog.simulate.tasks import Demand
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import MAX_GAP, STANDING_SPEED, runs

Floats = NDArray[np.float64]
LONG_STAND = 60.0
"""A truck that needs charge and stands for this long, without a load and not plugged in, waits for a plug [s]."""
UNLADEN = 25.0


@dataclass(frozen=True)
class Trial:
    """How a plan is tried: trucks, seconds, seed and the state of charge at the start."""

    truck: Truck
    vehicles: int
    duration: float = 8 * 3600.0
    seed: int = 0
    soc: float = 0.6


def try_plan(dataset: Dataset, sites: pd.DataFrame, trial: Trial) -> dict[str, Any]:
    """Simulate ``before`` (the site's own chargers) and ``after`` (those of ``sites``: x, y, plugs), all else equal.

    Tasks are drawn like the recorded ones, with the same seed for both; where the recording shows no loads, they are
    random, and then only the seed is the same.  Power of a planned plug is that of the site's first charger that states one.
    """
    from fleetlog.simulate.places import like

    start = DEFAULT_START if dataset.kind == "simulated" else _start(dataset)
    own = {p.id for p in dataset.site.places}
    site, tasks, notes = like(
        dataset, dataset.site, trial.truck, trial.vehicles, start, trial.duration, trial.seed
    )
    mined = frozenset(p.id for p in site.places) - own
    planned = with_chargers(site, sites)
    new = frozenset(p.id for p in planned.places if p.kind == "charge")
    demand = Demand(tasks, endless=not tasks)
    out: dict[str, Any] = {
        "vehicles": trial.vehicles, "hours": trial.duration / 3600.0, "seed": trial.seed, "soc_start": trial.soc,
        "before": _run(site, trial, start, demand, mined), "after": _run(planned, trial, start, demand, mined | new),
    }  # fmt: skip
    out["notes"] = notes
    return out


def with_chargers(site: Site, sites: pd.DataFrame) -> Site:
    """The site with its chargers replaced by the planned ones, one place a plug."""
    present = [p for p in site.places if p.kind == "charge"]
    power = next((p.power for p in present if np.isfinite(p.power)), float("nan"))
    kept = [p for p in site.places if p.kind != "charge"]
    taken = {p.id for p in kept}
    new = []
    columns = (sites[c].to_numpy(dtype=float) for c in ("x", "y", "plugs"))
    for number, (x, y, plugs) in enumerate(zip(*columns, strict=True), start=1):
        for plug in range(int(plugs)):
            name = f"charger-{number}" + (f"-{plug + 1}" if plug else "")
            while name in taken:
                name += "p"
            new.append(Place(name, "charge", float(x), float(y), power=power))
    return replace(site, places=(*new, *kept))


def _start(dataset: Dataset) -> int:
    return int(np.datetime64(str(dataset.meta["start"]).rstrip("Z"), "us").astype(np.int64))


def _run(site: Site, trial: Trial, start: int, demand: Demand, mined: frozenset[str]) -> dict[str, Any]:
    policy = Policy()
    settings = Settings(
        trial.vehicles,
        trial.duration,
        interval=5.0,
        start=start,
        seed=trial.seed,
        soc=trial.soc,
        policy=policy,
    )
    with TemporaryDirectory() as scratch:
        with DatasetWriter.create(Path(scratch) / "trial", "simulated", site) as writer:
            summary = simulate(site, trial.truck, writer, settings, demand, mined=mined)
        charge = follow_charge(Dataset(Path(scratch) / "trial"), policy.low)
    chargers = [p for p in site.places if p.kind == "charge"]
    return {
        "plugs": sum(1 if p.id in mined else max(p.plugs, 1) for p in chargers),
        **charge,
        "empty_trucks": len(summary.count.empty), "tasks_given": summary.count.tasks_given,
        "tasks_done": summary.count.tasks_done, "charges": summary.count.charges,
        "charged_kwh": summary.charged_wh / 1000.0, "driven_km": summary.distance_m / 1000.0, "notes": summary.notes,
    }  # fmt: skip


def follow_charge(dataset: Dataset, low: float) -> dict[str, float]:
    """Lowest, mean and last state of charge of a fleet, and truck hours of waiting for a plug.

    A truck waits where it stands for a minute or more below the charge ``low`` at which it would plug in, with nothing on its
    forks and no current into the battery.
    """
    lowest, total, seconds, waiting = 1.0, 0.0, 0.0, 0.0
    final: dict[str, float] = {}
    for t in dataset.days(("speed", "soc", "battery_power", "payload")):
        soc, dt = t.floats("soc"), _durations(t)
        lowest = min(lowest, float(np.nanmin(soc)))
        known = np.isfinite(soc)
        total, seconds = total + float((soc * dt)[known].sum()), seconds + float(dt[known].sum())
        final[t.vehicle_id] = float(soc[known][-1])
        waiting += _waiting(t, dt, low)
    last = list(final.values())
    return {
        "soc_lowest": lowest, "soc_mean": total / max(seconds, 1e-9), "soc_end_mean": float(np.mean(last)),
        "soc_end_lowest": float(np.min(last)), "waiting_for_plug_h": waiting / 3600.0,
    }  # fmt: skip


def _durations(t: Trajectory) -> Floats:
    time = t.seconds()
    return np.asarray(np.clip(np.diff(time, append=time[-1:]), 0.0, MAX_GAP))


def _waiting(t: Trajectory, dt: Floats, low: float) -> float:
    stands = (
        (t.floats("speed") <= STANDING_SPEED) & (t.floats("soc") < low)
        & (t.floats("battery_power") >= 0.0) & ~(t.floats("payload") > UNLADEN)
    )  # fmt: skip
    spells = [float(dt[a:b].sum()) for a, b in runs(stands)]
    return sum(s for s in spells if s >= LONG_STAND)
