"""What one simulation is made of; runs of many, and what one more of a scarce thing brings."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fleetlog import engines, scratch
from fleetlog.core.site import Site
from fleetlog.core.truck import Truck
from fleetlog.errors import FleetlogError
from fleetlog.physics.power import Physics
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.limits import Resource, Summary
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
            TemporaryDirectory(dir=scratch.folder()) as folder,
            DatasetWriter.create(Path(folder) / "run", "simulated", self.site) as writer,
        ):
            return few_rows.write(writer)


def attempt(scenario: Scenario) -> Summary | str:
    """The summary of a run, or why it is impossible."""
    try:
        return scenario.run()
    except FleetlogError as error:
        return str(error)


def run_all(scenarios: Sequence[Scenario]) -> Iterator[Summary | str]:
    """What becomes of every scenario, in their order, on the engine in use."""
    yield from engines.current().run(attempt, scenarios, lambda s: f"seed {s.settings.seed}")


def with_plugs(site: Site, place: str, plugs: int) -> Site:
    """The site with room for so many trucks at one of its places."""
    changed = (replace(p, plugs=plugs) if p.id == place else p for p in site.places)
    return replace(site, places=tuple(changed))


def with_one_more(scenario: Scenario, scarce: Resource) -> tuple[Scenario, str] | None:
    """The scenario with one truck, place or plug more, and its name; None where that cannot be had."""
    if scarce.kind == "trucks":
        settings = replace(scenario.settings, vehicles=scarce.count + 1)
        return replace(scenario, settings=settings), "one more truck"
    place = next((p for p in scenario.site.places if p.id == scarce.name), None)
    if scarce.kind == "junctions" or place is None:
        return None
    site = with_plugs(scenario.site, place.id, max(place.plugs, 1) + 1)
    thing = "plug" if scarce.kind == "chargers" else scarce.kind.removesuffix("s")
    return replace(scenario, site=site), f"one more {thing} at {place.id}"


def one_more(scenario: Scenario, before: Summary) -> dict[str, Any]:
    """What one more of what limits a run brings, with the same tasks; empty where nothing limits it."""
    scarce = before.limits.bottleneck
    if scarce is None:
        return {}
    if scarce.kind == "junctions":
        return _without_traffic(before)
    change = with_one_more(scenario, scarce)
    if change is None:
        return {}
    more, what = change
    after = attempt(more)
    if isinstance(after, str):
        return {"what": what, "statement": f"{what}: not possible ({after})"}
    count = {r.kind: r.count for r in after.limits.resources}[scarce.kind]
    if count == scarce.count:
        return {"what": what, "statement": f"{what}: there is no room for it beside the road"}
    done = (before.count.tasks_done, after.count.tasks_done)
    waits = (before.limits.task_wait_s["mean"], after.limits.task_wait_s["mean"])
    hours = (before.waiting_s / 3600.0, after.waiting_s / 3600.0)
    statement = f"{what}: {done[1]} tasks done instead of {done[0]}, "
    statement += f"{hours[1]:.2f} truck hours of waiting instead of {hours[0]:.2f}"
    if max(waits) > 0.0:
        statement += f", tasks wait {waits[1]:.0f} s instead of {waits[0]:.0f} s"
    return {
        "what": what, "tasks_done": done[1], "task_wait_s": round(waits[1], 2),
        "waiting_s": round(after.waiting_s, 1), "statement": statement,
    }  # fmt: skip


def _without_traffic(before: Summary) -> dict[str, Any]:
    """An upper bound on the gain where traffic limits: the time that all waiting on the road takes."""
    total, lost = before.vehicles * before.duration_s, before.limits.waiting_s["traffic"]
    gain = lost / max(total - lost, 1.0)
    what = "no waiting on the road"
    statement = f"{what}: at most {100 * gain:.0f} % more time for tasks"
    return {"what": what, "at_most_share": round(gain, 4), "statement": statement}
