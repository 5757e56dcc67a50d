"""A charging plan tried out in the simulator: the same tasks with present and with planned chargers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.core.site import Place, Site
from fleetlog.core.truck import Truck
from fleetlog.simulate.engine import Settings
from fleetlog.simulate.limits import Summary
from fleetlog.simulate.scenario import Scenario
from fleetlog.store import Dataset


def try_plan(dataset: Dataset, sites: pd.DataFrame, truck: Truck, settings: Settings) -> dict[str, Any]:
    """Simulate ``before`` (the site's own chargers) and ``after`` (``sites``: x, y, plugs), all else equal.

    Tasks are drawn like the recorded ones, with the same seed for both; where the recording shows no loads,
    they are random, and then only the seed is the same.  The power of a planned plug is that of the site's
    first charger that states one.
    """
    from fleetlog.simulate.demand import like

    if dataset.kind == "recorded":
        start = np.datetime64(str(dataset.meta["start"]).rstrip("Z"), "us").astype(np.int64)
        settings = replace(settings, start=int(start))
    own = {p.id for p in dataset.site.places}
    of = settings.vehicles, settings.start, settings.duration, settings.seed
    site, demand, notes = like(dataset, dataset.site, truck, *of)
    mined = frozenset(p.id for p in site.places) - own
    planned = with_chargers(site, sites)
    new = frozenset(p.id for p in planned.places if p.kind == "charge")
    present = Scenario(site, truck, settings, demand, mined=mined)
    both = {"before": present, "after": replace(present, site=planned, mined=mined | new)}
    out: dict[str, Any] = {
        "vehicles": settings.vehicles, "hours": settings.duration / 3600.0, "seed": settings.seed,
        "soc_start": settings.soc,
    }  # fmt: skip
    for name, scenario in both.items():
        chargers = [p for p in scenario.site.places if p.kind == "charge"]
        plugs = sum(1 if p.id in scenario.mined else max(p.plugs, 1) for p in chargers)
        out[name] = _compared(scenario.run(), plugs)
    return out | {"notes": notes}


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


def _compared(summary: Summary, plugs: int) -> dict[str, Any]:
    """What a trial is judged by."""
    count = summary.count
    return {
        "plugs": plugs, "soc_lowest": summary.soc_lowest, "soc_mean": summary.soc_mean,
        "soc_end_mean": float(np.mean(summary.soc_end)), "soc_end_lowest": min(summary.soc_end),
        "waiting_for_plug_h": summary.limits.waiting_s["chargers"] / 3600.0,
        "empty_trucks": len(count.empty), "tasks_given": count.tasks_given, "tasks_done": count.tasks_done,
        "charges": count.charges, "charged_kwh": summary.charged_wh / 1000.0,
        "driven_km": summary.distance_m / 1000.0, "notes": summary.notes,
    }  # fmt: skip
