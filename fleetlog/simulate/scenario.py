"""What one simulation is made of, what one more of a scarce thing brings; experiments that vary settings."""

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from fleetlog import engines, scratch
from fleetlog.core.arguments import NONE, Factor
from fleetlog.core.result import Result, Spread, half_width
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.core.words import Sentences, percent
from fleetlog.errors import DataError, FleetlogError, nearest
from fleetlog.listening import listening, progress, unheard
from fleetlog.physics.power import Physics
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.limits import MATERIAL, Resource, Summary
from fleetlog.simulate.occupancy import Policy
from fleetlog.simulate.tasks import Demand
from fleetlog.store.writer import DatasetWriter

SAID = Sentences(__file__)
MEASURES = {  # What is drawn and compared, and how it is called
    "tasks_per_h": "tasks done per hour", "task_wait_s": "mean time that a task waits for a truck [s]",
    "waiting_share": "share of the trucks' time spent waiting [%]",
    "energy_per_task_wh": "energy per task done [Wh]",
}  # fmt: skip
LITTLE = 0.02  # One more that adds less to the tasks done than this brings little: seeds differ by as much
MOST = 10_000  # Variants of an experiment; a number of trucks, plugs or places is below a hundred thousand


@dataclass(frozen=True)
class Scenario:
    """Where, with what, how and what for; arguments as of :func:`fleetlog.simulate.engine.simulate`."""

    site: Site
    truck: Truck | tuple[Truck, ...]
    settings: Settings
    demand: Demand = field(default_factory=Demand)
    physics: Physics | None = None
    mined: frozenset[str] = frozenset()

    def write(self, writer: DatasetWriter) -> Summary:
        """Simulate and write the trajectories."""
        return simulate(self.site, self.truck, writer, self.settings, self.demand, self.physics, self.mined)

    def run(self) -> Summary:
        """Simulate and keep only the summary."""
        second = max(round(1.0 / self.settings.step), 1) * self.settings.step
        with (
            listening(unheard, unheard),
            TemporaryDirectory(dir=scratch.folder()) as folder,
            DatasetWriter.create(Path(folder) / "run", "simulated", self.site) as writer,
        ):
            return replace(self, settings=replace(self.settings, interval=10.0 * second)).write(writer)


def attempt(scenario: Scenario) -> Summary | str:
    """The summary of a run, or why it is impossible."""
    try:
        return scenario.run()
    except FleetlogError as error:
        return str(error)


def with_plugs(site: Site, place: str, plugs: int) -> Site:
    """The site with room for so many trucks at one of its places."""
    return replace(site, places=tuple(replace(p, plugs=plugs) if p.id == place else p for p in site.places))


def one_more(scenario: Scenario, before: Summary) -> dict[str, Any]:
    """What one more of what limits a run brings, with the same tasks; empty where nothing does. Who waits
    for one place may hold up another: what is waited for next is tried where the first brings little."""
    scarce, least = before.limits.bottleneck, (1.0 + LITTLE) * before.count.tasks_done
    if scarce is None:
        return {}
    first, rest = _one_more(scenario, before, scarce), (r for r in before.limits.resources if r != scarce)
    other = max((r for r in rest if r.name and r.kind != "junctions"), key=lambda r: r.queue, default=scarce)
    if first.get("tasks_done", least) < least and MATERIAL * before.vehicles < other.queue < scarce.queue:
        second = _one_more(scenario, before, other)
        if second.get("tasks_done", 0) >= least:
            return {**second, "statement": f"{first['statement']}; {second['statement']}"}
    return first


def _one_more(scenario: Scenario, before: Summary, scarce: Resource) -> dict[str, Any]:
    if scarce.kind == "junctions":
        # An upper bound: the time that all waiting on the road takes.
        lost = before.limits.waiting_s["traffic"]
        gain = lost / max(before.vehicles * before.duration_s - lost, 1.0)
        what = "no waiting on the road"
        statement = f"{what} would leave trucks at most {percent(gain)} more time for tasks"
        return {"what": what, "at_most_share": round(gain, 4), "statement": statement}
    place = next((p for p in scenario.site.places if p.id == scarce.name), None)
    if scarce.kind == "trucks" and scarce.name is None:
        what = "one more truck"
        more = replace(scenario, settings=replace(scenario.settings, vehicles=scarce.count + 1))
    elif place is not None:
        thing = "plug" if scarce.kind == "chargers" else scarce.kind.removesuffix("s")
        what = f"one more {thing} at {place.id}"
        more = replace(scenario, site=with_plugs(scenario.site, place.id, max(place.plugs, 1) + 1))
    else:
        return {}
    after = attempt(more)
    if isinstance(after, str):
        return {"what": what, "statement": f"{what}: not possible ({after})"}
    if scarce.count == next(r.count for r in after.limits.resources if r.kind == scarce.kind):
        return {"what": what, "statement": f"{what}: there is no room for it beside the road"}
    hours = [s.waiting_s / 3600.0 for s in (after, before)]
    waits = [s.limits.task_wait_s["mean"] for s in (after, before)]
    statement = SAID("one_more", what=what, after=after, before=before, hours=hours)
    if max(waits) > 0.0:
        statement += SAID("task_wait", waits=waits)
    told = {"what": what, "tasks_done": after.count.tasks_done, "task_wait_s": round(waits[0], 2)}
    return {**told, "waiting_s": round(after.waiting_s, 1), "statement": statement}


def _whole(value: str, name: str) -> int:
    if not re.fullmatch("[0-9]{1,5}", value) or int(value) < 1:
        what = f"{name}={value[:40]} is no number from 1 to 99,999"
        raise DataError(what, do=f"write {name}=2..6 or {name}=1,2,4")
    return int(value)


def varied(scenario: Scenario, name: str, value: str) -> Scenario:
    """The scenario with one setting changed; a place's id as the name changes its room for trucks."""
    site, settings, places = scenario.site, scenario.settings, [p.id for p in scenario.site.places]
    if name == "vehicles":
        settings = replace(settings, vehicles=_whole(value, name))
    elif name == "policy":
        settings = replace(settings, policy=Policy.named(value, settings.policy.low))
    elif name == "plugs":
        chargers, plugs = [p.id for p in site.places if p.kind == "charge"], _whole(value, name)
        if not chargers:
            do = "add a place of kind charge"
            raise DataError("plugs cannot be varied: the site has no charger", do=do)
        # So many in all, spread evenly in the site's order; a charger without a plug is none.
        for k, place in enumerate(chargers):
            site = with_plugs(site, place, plugs // len(chargers) + (k < plugs % len(chargers)))
        site = replace(site, places=tuple(p for p in site.places if p.plugs or p.id not in chargers))
    elif name == "close":
        closed = () if value == NONE else value.split("+")
        site = replace(site, network=site.roads().without(closed)) if closed else site
    elif name in places:
        site = with_plugs(site, name, _whole(value, name))
    else:
        known = ["vehicles", "plugs", "close", "policy", *places]
        raise DataError(f"{name!r} is neither a setting nor a place to vary", do=nearest(name, known))
    return replace(scenario, site=site, settings=settings)


def variants(base: Scenario, factors: Sequence[Factor]) -> list[tuple[dict[str, str], Scenario]]:
    """Every combination of values, and the scenario that it makes of ``base``."""
    if math.prod(len(f.values) for f in factors) > MOST:
        raise DataError(f"these values make more than {MOST:,} variants", do="vary less at once")
    if len({f.name for f in factors}) < len(factors):
        raise DataError("a setting is varied twice", do="name each once, with all its values")
    fleets = [_whole(v, f.name) for f in factors if f.name == "vehicles" for v in f.values]
    base = replace(base, settings=replace(base.settings, room=max([base.settings.vehicles, *fleets])))
    out = []
    for values in itertools.product(*(f.values for f in factors)):
        chosen, scenario = dict(zip((f.name for f in factors), values, strict=True)), base
        for name, value in chosen.items():
            scenario = varied(scenario, name, value)
        out.append((chosen, scenario))
    return out


def experiment(bases: Sequence[Scenario], factors: Sequence[Factor]) -> Result:
    """Run every variant of every base, which differ in their seeds alone. Tables ``runs`` (a row a variant
    and seed) and ``variants`` (means over the seeds, half widths of their 95 % intervals, changes paired by
    seed). :class:`DataError` for no factor, or where no run is possible."""
    plan = [(k, base.settings.seed, *v) for base in bases for k, v in enumerate(variants(base, factors))]
    rows = []
    results = engines.current().run(attempt, [s for *_, s in plan], lambda s: f"seed {s.settings.seed}")
    for (number, seed, values, _), outcome in zip(plan, results, strict=True):
        rows.append({"variant": number, "seed": seed, **values, **_measured(outcome)})
        progress("experiment", len(rows) / len(plan))
    runs = pd.DataFrame(rows).sort_values(["variant", "seed"], ignore_index=True)
    if "tasks_done" not in runs:
        raise DataError(f"no run is possible: {runs.error[0]}", do="change the site or what is varied")
    table = _compared(runs, [f.name for f in factors])
    summary = {
        "format_version": 2, "factors": {f.name: list(f.values) for f in factors},
        "seeds": [b.settings.seed for b in bases], "variants": table.to_dict("records"),
    }  # fmt: skip
    tables, rows_told = {"runs": runs, "variants": table}, told_rows(table, [f.name for f in factors])
    wide = [max(map(len, column)) for column in zip(*rows_told, strict=True)]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, wide, strict=True)).rstrip() for row in rows_told]
    each = [", ".join(f"{f.name} = {row[f.name]}" for f in factors) for row in table.to_dict("records")]
    best, rate = int(table.tasks_per_h.argmax()), runs.pivot(index="seed", columns="variant").tasks_per_h
    # The demand of a seed is the same in all variants: what differs is told seed by seed.
    fewer = {k: (rate[best] - rate[k]).dropna().to_numpy(float) for k in rate if k != best}
    near = [each[k] for k, f in fewer.items() if len(f) and f.mean() <= np.nan_to_num(half_width(f))]
    told = f" The runs do not tell it from {'; '.join(near)}." if near else ""
    lines.append(f"Most tasks are done with {each[best]}: {table.tasks_per_h[best]:.1f} per hour.{told}")
    return Result("experiment", summary, tables, {}, _shapes(runs, factors), lines)


def _measured(outcome: Summary | str) -> dict[str, Any]:
    if isinstance(outcome, str):
        return {"error": outcome}
    s, hours, c = outcome, outcome.duration_s / 3600.0, outcome.count
    worst = s.limits.bottleneck
    return {
        "tasks_given": c.tasks_given, "tasks_done": c.tasks_done, "tasks_per_h": c.tasks_done / hours,
        "task_wait_s": s.limits.task_wait_s["mean"], "task_wait_p95_s": s.limits.task_wait_s["p95"],
        "waiting_share": s.waiting_s / (s.vehicles * s.duration_s),
        **{f"waiting_{k.replace(' ', '_')}_h": v / 3600.0 for k, v in s.limits.waiting_s.items()},
        "busy_share": next(r.utilisation for r in s.limits.resources if r.kind == "trucks"),
        "distance_km": s.distance_m / 1000.0, "energy_kwh": s.energy_wh / 1000.0,
        "charged_kwh": s.charged_wh / 1000.0, "energy_per_task_wh": s.energy_wh / (c.tasks_done or np.nan),
        "charges": c.charges, "soc_lowest": s.soc_lowest, "longest_wait_s": s.longest_wait_s,
        "deadlocks": c.deadlocks, "empty": len(c.empty),
        "left_out": "; ".join(note for note in s.notes if note.startswith("places left out")),
        "bottleneck": "none" if worst is None else worst.kind + (f", {worst.name}" if worst.name else ""),
    }  # fmt: skip


def _compared(runs: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """One row a variant: means over the seeds, half widths, and the paired change from the first variant."""
    first = runs[runs.variant == 0].set_index("seed")
    out = []
    for number, group in runs.groupby("variant"):
        good = group.dropna(subset="tasks_done").set_index("seed")
        row = {"variant": number, **group[names].iloc[0], "runs": len(group), "possible": len(good)}
        for name in MEASURES:
            for key, values in {name: good[name], f"{name}_change": good[name] - first[name]}.items():
                row |= {key: float(values.mean()), f"{key}_ci": half_width(values.dropna().to_numpy(float))}
        row["bottleneck"] = good.bottleneck.mode().iloc[0] if len(good) else str(group.error.iloc[0])
        row["left_out"] = "; ".join(good.left_out.unique())
        out.append(row)
    return pd.DataFrame(out)


def told_rows(table: pd.DataFrame, names: Sequence[str]) -> list[list[str]]:
    """The variants in words, below their heads; ``names`` are those of what is varied."""

    def number(row: Mapping[Any, Any], name: str, unit: str = "", sign: str = "") -> str:
        scale = 100.0 if unit == " %" else 1.0
        value, half = scale * row[name], scale * row[f"{name}_ci"]
        if np.isnan(value):
            return "-"
        return f"{value:{sign}.1f}" + (f" ± {half:.1f}" if np.isfinite(half) else "") + unit

    rows = [[*names, "tasks/h", "change", "waiting", "Wh/task", "task waits", "bottleneck"]]
    for row in table.to_dict("records"):
        change = "" if row["variant"] == 0 else number(row, "tasks_per_h_change", sign="+")
        shares = number(row, "waiting_share", " %"), number(row, "energy_per_task_wh")
        said = "; ".join(filter(None, [str(row["bottleneck"]), row["left_out"]]))
        told = number(row, "tasks_per_h"), change, *shares, number(row, "task_wait_s", " s"), said
        rows.append([*(str(row[name]) for name in names), *told])
    return rows if table.task_wait_s.any() else [[*row[:-2], row[-1]] for row in rows]


def _shapes(runs: pd.DataFrame, factors: Sequence[Factor]) -> list[Any]:
    """A plot of each measure over the first factor's values, a curve for each combination of the others."""
    first, rest = factors[0], [f.name for f in factors[1:]]
    groups = list(runs.groupby(rest, sort=False)) if rest else [((), runs)]
    out = []
    for name, label in MEASURES.items():
        if not runs[name].any():
            continue
        scale = 100.0 if label.endswith("[%]") else 1.0
        curves = {
            ", ".join(f"{n} {v}" for n, v in zip(rest, key, strict=True)): [
                scale * group[group[first.name] == v][name].dropna().to_numpy(float) for v in first.values
            ]
            for key, group in groups
        }
        out.append(Spread(name, first.values, curves, first.name, label))
    return out
