"""Where and when trucks exceed the speed limit."""

from typing import Annotated, Any

import numpy as np
import pandas as pd

from fleetlog.analysis.apart import settled
from fleetlog.analysis.utilisation import joined_days, stamps
from fleetlog.core.arguments import Between, Share
from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.result import Marks, Result
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.words import Sentences, percent
from fleetlog.store import Dataset
from fleetlog.store.trips import MAX_GAP, STANDING_SPEED, runs

COLUMNS = ("x", "y", "speed", "edge_id")
EVENTS = ("vehicle_id", "start", "end", "duration", "top_speed", "limit", "place", "x", "y")
WORST = 12
SAID = Sentences(__file__)


def speeding(
    dataset: Dataset, *, margin: Share = 0.1, shortest: Annotated[float, Between(0.0, 3600.0)] = 2.0
) -> Result:
    """Find where and when trucks exceed the limit of the road, or of the zone where that is lower.

    The result has table ``speeding`` (s, m/s, m), the longest first; summary with seconds over
    the limit and seconds driven where a limit is known.

    Parameters
    ----------
    margin : share of the limit that a truck may exceed it by; logged speeds are a few per cent off.
    shortest : shorter stretches are ignored [s]."""
    found, driven = [], 0.0
    for t in joined_days(dataset, COLUMNS):
        events, seconds = _events(t, dataset.site, margin)
        found += [event for event in events if event[3] >= shortest]
        driven += seconds
    table = pd.DataFrame(found, columns=list(EVENTS))
    table = table.assign(**{c: stamps(table[c].to_numpy(np.int64)) for c in ("start", "end")})
    by = ["duration", "vehicle_id", "start"]
    table = table.sort_values(by, ascending=[False, True, True], ignore_index=True)
    summary = {
        "margin": margin, "shortest_s": shortest, "events": len(table), "limited_s": driven,
        "over_s": float(table["duration"].sum()),
        "top_speed_m_s": float(table["top_speed"].max()) if len(table) else None,
    }  # fmt: skip
    worst = table.head(WORST)
    labels, size = tuple(f"{v:.1f} m/s" for v in worst["top_speed"]), np.full(len(worst), 1.0)
    some = f"the {len(worst)} longest of {len(table)} " if len(table) > len(worst) else ""
    name = f"{some}drives above the limit, with the highest speed"
    marks = Marks(name, worst[["x", "y"]].to_numpy(float), labels, size, "critical")
    result = Result("speeding", summary, {}, {"speeding": table}, [marks], _lines(summary, table))
    return settled(result, dataset, "Speeding", "events", "limited_s", "over_s", limit=MAX_GAP)


def _lines(s: dict[str, Any], table: pd.DataFrame) -> list[str]:
    if not s["limited_s"]:
        return ["No speed limit is known: neither the roads nor the zones of the site have one."]
    margin = percent(s["margin"])
    if not len(table):
        return [f"No truck drives more than {margin} above the limit for {s['shortest_s']:g} s or longer."]
    places = table.groupby("place")["duration"].sum().sort_values(ascending=False, kind="stable")
    times = "once" if len(table) == 1 else f"{len(table)} times"
    share, where = 100 * s["over_s"] / s["limited_s"], {"place": places.index[0], "seconds": places.iloc[0]}
    return [SAID("over", by=margin, times=times, share=share, **where, **s)]


def limits(t: Trajectory, site: Site) -> tuple[Floats, Ints]:
    """(N,) limit [m/s], inf where none; and whose it is: an edge's, or -1 - k of zone k."""
    limit, whose = np.full(len(t), np.inf), np.full(len(t), 0, np.int64)
    if site.network is not None:
        edge = t.labels("edge_id").recode(site.network.index)
        own = np.where(edge >= 0, site.network.speed_limit[edge], np.nan)
        limit, whose = np.where(np.isfinite(own), own, np.inf), edge.astype(np.int64)
    for k, zone in enumerate(site.zones):
        if np.isfinite(zone.speed_limit):
            inside = zone.contains(t.floats("x"), t.floats("y")) & (zone.speed_limit < limit)
            limit[inside], whose[inside] = zone.speed_limit, -1 - k
    return limit, whose


def _events(t: Trajectory, site: Site, margin: float) -> tuple[list[tuple[Any, ...]], float]:
    """The runs of rows above the limit, and the seconds driven under a limit."""
    limit, whose = limits(t, site)
    speed = np.nan_to_num(t.floats("speed"))
    step = np.diff(t.time, append=t.time[-1:]) * 1e-6
    dt = np.where(step <= MAX_GAP, step, 0.0)
    x, y = t.floats("x"), t.floats("y")
    rows: list[tuple[Any, ...]] = []
    for a, b in runs((speed > limit * (1.0 + margin)) & (dt > 0.0)):
        k = a + int(np.argmax(speed[a:b] - limit[a:b]))
        place = site.zones[-1 - whose[k]].id if whose[k] < 0 else site.roads().edge_ids[whose[k]]
        figures = dt[a:b].sum(), speed[a:b].max(), limit[k]
        rows.append((t.vehicle_id, t.time[a], t.time[min(b, len(t) - 1)], *figures, place, x[k], y[k]))
    return rows, float(dt[np.isfinite(limit) & (speed > STANDING_SPEED)].sum())
