"""What a simulation came to, for people and as JSON."""

from dataclasses import dataclass, field
from typing import Any

from fleetlog.simulate.limits import Limits
from fleetlog.simulate.untangle import Count


@dataclass
class Summary:
    """What was simulated."""

    vehicles: int
    duration_s: float
    rows: int
    vehicle_steps: int
    count: Count
    distance_m: float
    energy_wh: float
    charged_wh: float
    soc_end: list[float]
    soc_lowest: float
    soc_mean: float
    limits: Limits
    longest_wait_s: float
    """Longest time that a truck which wanted to move stood on end."""
    unfinished: int
    notes: list[str]
    one_more: dict[str, Any] = field(default_factory=dict)
    """What one more of what limits brings; empty where that was not simulated."""

    @property
    def waiting_s(self) -> float:
        """Truck seconds of waiting of every kind."""
        return sum(self.limits.waiting_s.values())

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        c = self.count
        return {
            "vehicles": self.vehicles, "duration_s": self.duration_s, "rows": self.rows,
            "vehicle_steps": self.vehicle_steps, "tasks_given": c.tasks_given, "tasks_done": c.tasks_done,
            "tasks_unfinished": self.unfinished, "distance_m": round(self.distance_m, 1),
            "energy_wh": round(self.energy_wh, 2), "charged_wh": round(self.charged_wh, 2),
            "soc_end": [round(s, 5) for s in self.soc_end], "soc_lowest": round(self.soc_lowest, 5),
            "soc_mean": round(self.soc_mean, 5), "waiting_s": round(self.waiting_s, 1),
            "longest_wait_s": round(self.longest_wait_s, 1),
            "charges": c.charges, "deadlocks": c.deadlocks, "deadlocks_released": c.deadlocks_released,
            "detours": c.detours, "made_room": c.made_room, "empty": c.empty,
            "limits": {**self.limits.to_dict(), "one_more": self.one_more}, "notes": self.notes,
        }  # fmt: skip

    def lines(self) -> list[str]:
        """For the terminal."""
        c, hours = self.count, {k: s / 3600.0 for k, s in self.limits.waiting_s.items()}
        kinds = ", ".join(f"{kind} {h:.2f}" for kind, h in hours.items())
        out = [
            f"{self.vehicles} trucks, {self.duration_s / 3600.0:.2f} h, {self.rows} rows,"
            f" {self.distance_m / 1000.0:.1f} km",
            f"tasks: {c.tasks_done} done of {c.tasks_given}, {self.unfinished} not finished at the end",
            f"energy: {self.energy_wh / 1000.0:.2f} kWh used,"
            f" {self.charged_wh / 1000.0:.2f} kWh charged in {c.charges} visits",
            f"waiting: {sum(hours.values()):.2f} truck hours ({kinds})",
            f"traffic: {self.longest_wait_s:.0f} s of waiting at most,"
            f" {c.deadlocks} deadlocks ({c.deadlocks_released} released), {c.detours} detours",
            *self.limits.lines(),
        ]
        if self.one_more:
            out.append(str(self.one_more["statement"]))
        if c.empty:
            out.append(f"battery empty: {', '.join(c.empty)}")
        return out
