"""One physics for all: the same dataset has the same energy by term wherever it is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fleetlog
from fleetlog.analysis.energy import energy
from fleetlog.core.truck import load_truck
from fleetlog.discovery.recording.fleet import read_fleet
from fleetlog.physics.power import Physics, ledger
from fleetlog.simulate.mission import replay
from fleetlog.store import Dataset, DatasetWriter

SAMPLE = Path(__file__).parents[2] / "sample_data"
TRUCK = load_truck(SAMPLE / "truck.toml")
FOUND = Physics(TRUCK, {"viscous_drag": {"coefficient": 40.0}, "rolling_resistance": {"coefficient": 0.018}})
JOULES = 3.6e6


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Half an hour of a truck alone on the sample plant, with a viscous drag and a rolling resistance beyond the
    file's."""
    folder = tmp_path_factory.mktemp("energy")
    toml = "[term.viscous_drag]\ncoefficient = 40.0\n[term.rolling_resistance]\ncoefficient = 0.018\n"
    (folder / "model.toml").write_text(toml)
    fleetlog.simulate(
        site=SAMPLE / "site.toml", truck=SAMPLE / "truck.toml", vehicles=1, duration="30min", seed=6, rate=10.0,
        physics=folder / "model.toml", recording=False, output=folder / "day",
    )  # fmt: skip
    return Dataset(folder / "day")


def of_diagnosis(dataset: Dataset) -> dict[str, float]:
    """kWh by term on the motion that a diagnosis looks at."""
    total: dict[str, float] = {}
    fleet = read_fleet(dataset, TRUCK)
    for _, block in (pair for date in fleet.dates for pair in fleet.each_block(date)):
        for name, watts in ledger(block.motion, FOUND).items():
            total[name] = total.get(name, 0.0) + float(watts @ block.motion.dt) / JOULES
    return total


def test_every_term_costs_the_same_in_analysis_and_diagnosis(recorded: Dataset) -> None:
    analysed = energy(recorded, TRUCK, FOUND).summary
    whole, terms = analysed["energy_kwh"], analysed["ledger_kwh"]
    assert whole == pytest.approx(analysed["measured_kwh"], rel=0.02)
    diagnosed = of_diagnosis(recorded)
    assert set(diagnosed) >= set(terms)
    for name, kwh in terms.items():
        assert diagnosed.get(name, 0.0) == pytest.approx(kwh, rel=0.01, abs=1e-3 * whole), name


@pytest.mark.xfail(
    strict=True,
    reason="a simulated truck keeps to its lane, so that its left turns are wider, and slows down before crossings; "
    "driven again it keeps to the middle of the road: inertia differs by 9 %, viscous drag by 12 %",
)
def test_every_term_costs_the_same_in_the_same_mission(recorded: Dataset, tmp_path: Path) -> None:
    with DatasetWriter.create(tmp_path / "again", "simulated", recorded.site) as writer:
        replay(recorded, TRUCK, writer, FOUND)
    first, again = (energy(d, TRUCK, FOUND).summary for d in (recorded, Dataset(tmp_path / "again")))
    terms = {n: kwh for n, kwh in first["ledger_kwh"].items() if kwh > 0.02 * first["energy_kwh"]}
    ratio = np.array([again["ledger_kwh"][n] / kwh for n, kwh in terms.items()])
    assert ratio == pytest.approx(1.0, rel=0.01)
