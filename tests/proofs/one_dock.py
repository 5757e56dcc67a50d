"""A plant in which one dock gets all the work, and the same plant with the work spread; simulated.

python tests/proofs/one_dock.py        what the density analysis says of both
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from fleetlog.core.site import Place, Site
from fleetlog.core.truck import load_truck
from fleetlog.roads import load_site
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.tasks import Demand, Task
from fleetlog.store import Dataset, DatasetWriter

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
DOCKS = {"yard": ("x", 54.0, (12.0, 16.0, 20.0, 24.0)), "hall b": ("x", 134.0, (15.0, 19.0, 23.0, 27.0))}
"""Four bays one after the other along an aisle: the fixed coordinate and the places along the other one [m]."""
DROPS = [(84, 40), (84, 20), (54, 40), (28, 42), (70, 58), (38, 30)]
PARKING = [(8, 12), (8, 36), (8, 48), (28, 12), (28, 48), (69, 3), (84, 48), (116, 48), (128, 48), (122, 16)]
"""So that a truck with nothing to do leaves the place where it set its load down [m]."""
TRUCKS, HOURS, EVERY = 12, 1.0, 5.0


def plant(dock: str) -> Site:
    """The sample plant with a dock of four bays and further places to bring loads to."""
    site, _ = load_site(SAMPLE / "site.toml")
    _, x, ys = DOCKS[dock]
    bays = [Place(f"dock-{chr(97 + i)}", "pick", x, y) for i, y in enumerate(ys)]
    drops = [Place(f"rack-{10 + i}", "drop", float(a), float(b)) for i, (a, b) in enumerate(DROPS)]
    parking = [Place(f"parking-{i}", "park", float(a), float(b)) for i, (a, b) in enumerate(PARKING)]
    kept = (p for p in site.places if not p.id.startswith("yard"))
    return replace(site, places=(*bays, *kept, *drops, *parking))


def dock_roads(site: Site, dock: str) -> set[str]:
    """The roads that the bays of the dock lie on."""
    n = site.roads()
    _, x, ys = DOCKS[dock]
    out = set()
    for y in ys:
        gap = [
            np.hypot(*(n.polyline(e)[:, :2].mean(axis=0) - (x, y))) + _off(n.polyline(e)[:, :2], x, y) * 1e3
            for e in range(len(n))
        ]
        out.add(n.roads[int(np.argmin(gap))])
    return out


def _off(line: np.ndarray, x: float, y: float) -> float:
    a, d = line[:-1], np.diff(line, axis=0)
    t = np.clip(((np.array([x, y]) - a) * d).sum(axis=1) / (d * d).sum(axis=1), 0, 1)
    return float(np.hypot(*(a + t[:, None] * d - (x, y)).T).min())


def tasks(site: Site, only: str | None, seed: int) -> list[Task]:
    """One load every five seconds, more than the fleet can do; from the dock only, or from every pick place alike."""
    rng = np.random.default_rng(seed)
    picks = [
        p.id
        for p in site.places
        if p.kind == "pick" and (only is None or (p.id.startswith("dock-") and p.id[5:].isalpha()))
    ]
    drops = [p.id for p in site.places if p.kind == "drop"]
    return [
        Task(None, picks[int(rng.integers(len(picks)))], drops[int(rng.integers(len(drops)))], 900.0, EVERY * i, (15.0, 15.0), (0.3, 0.3))
        for i in range(int(3600 * HOURS / EVERY))
    ]  # fmt: skip


def run(dock: str, out: Path, seed: int = 1, spread: bool = False) -> tuple[Dataset, Site]:
    """Simulate into ``out``."""
    site = plant(dock)
    demand = Demand(tasks(site, None if spread else dock, seed), endless=False)
    with DatasetWriter.create(out, "simulated", site) as writer:
        settings = Settings(TRUCKS, 3600.0 * HOURS, seed=seed)
        simulate(site, load_truck(SAMPLE / "truck.toml"), writer, settings, demand)
    return Dataset(out), site


def main() -> None:
    from fleetlog.analysis.density import density

    with tempfile.TemporaryDirectory() as folder:
        for dock in DOCKS:
            for seed in (1, 2, 3):
                for spread in (False, True):
                    data, site = run(dock, Path(folder) / f"{dock}{seed}{spread}", seed, spread)
                    print(
                        f"{dock}, seed {seed}, {'spread' if spread else 'one dock'}; its roads: {sorted(dock_roads(site, dock))}"
                    )
                    print("\n".join(density(data).lines[:4]))


if __name__ == "__main__":
    sys.exit(main())
