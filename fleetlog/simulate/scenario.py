"""What one simulation is made of, and what one more of a scarce thing brings."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.errors import FleetlogError
from fleetlog.physics.power import Physics
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.limits import Summary
from fleetlog.simulate.tasks import Demand
from fleetlog.store.writer import DatasetWriter


@dataclass(frozen=True)
class Scenario:
    """Where, with what, how and what for; arguments as of :func:`fleetlog.simulate.engine.simulate`."""

    site: Site
    truck: Truck | tuple[Truck, ...]
    settings: Settings
    demand: Demand = field(default_factory=Demand)
    physics: Physics | None = None
    mined: frozenset[str] = frozenset()

    def write(self, writer: DatasetWriter, progress: Callable[[float, float], None] | None = None) -> Summary:
        """Simulate and write the trajectories."""
        what = (self.settings, self.demand, self.physics)
        return simulate(self.site, self.truck, writer, *what, progress, mined=self.mined)

    def run(self) -> Summary:
        """Simulate and keep only the summary."""
        second = max(round(1.0 / self.settings.step), 1) * self.settings.step
        few_rows = replace(self, settings=replace(self.settings, interval=10.0 * second))
        with (
            TemporaryDirectory() as scratch,
            DatasetWriter.create(Path(scratch) / "run", "simulated", self.site) as writer,
        ):
            return few_rows.write(writer)


def attempt(scenario: Scenario) -> Summary | str:
    """The summary of a run, or why it is impossible."""
    try:
        return scenario.run()
    except FleetlogError as error:
        return str(error)


def with_plugs(site: Site, place: str, plugs: int) -> Site:
    """The site with room for so many trucks at one of its places."""
    changed = (replace(p, plugs=plugs) if p.id == place else p for p in site.places)
    return replace(site, places=tuple(changed))


def one_more(scenario: Scenario, before: Summary) -> dict[str, Any]:
    """What one more of what limits a run brings, with the same tasks; empty where nothing limits it."""
    scarce = before.limits.bottleneck
    if scarce is None:
        return {}
    if scarce.kind == "junctions":
        # An upper bound: the time that all waiting on the road takes.
        lost = before.limits.waiting_s["traffic"]
        gain = lost / max(before.vehicles * before.duration_s - lost, 1.0)
        what = "no waiting on the road"
        statement = f"{what}: at most {100 * gain:.0f} % more time for tasks"
        return {"what": what, "at_most_share": round(gain, 4), "statement": statement}
    place = next((p for p in scenario.site.places if p.id == scarce.name), None)
    if scarce.kind == "trucks":
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
    done, waiting = after.count.tasks_done, after.waiting_s
    waits = before.limits.task_wait_s["mean"], after.limits.task_wait_s["mean"]
    statement = f"{what}: {done} tasks done instead of {before.count.tasks_done}, "
    statement += f"{waiting / 3600.0:.2f} truck hours of waiting instead of {before.waiting_s / 3600.0:.2f}"
    if max(waits) > 0.0:
        statement += f", tasks wait {waits[1]:.0f} s instead of {waits[0]:.0f} s"
    return {
        "what": what, "tasks_done": done, "task_wait_s": round(waits[1], 2), "waiting_s": round(waiting, 1),
        "statement": statement,
    }  # fmt: skip
