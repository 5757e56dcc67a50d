"""A term of a user's own is as good as a built-in one: found, written, simulated, drawn and worded."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import fleetlog
from fleetlog import engines
from fleetlog.analysis.energy import energy
from fleetlog.core.motion import Motion
from fleetlog.core.truck import Truck, load_truck
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.report.output import as_result, write_diagnosis
from fleetlog.physics.field import stretches
from fleetlog.physics.model import load_physics, save_physics
from fleetlog.physics.power import Physics, all_terms
from fleetlog.physics.term import Floats, Parameter, Term, Values
from fleetlog.report.diagnosis import diagnosis_page
from fleetlog.roads import load_site
from fleetlog.store import Dataset

SAMPLE = Path(__file__).parents[2] / "sample_data"
TRUCK = load_truck(SAMPLE / "truck.toml")
ROADS = ("yard-1", "-yard-1", "ramp", "-ramp", "b-aisle-00", "-b-aisle-00", "b-aisle-10", "-b-aisle-10")
"""On which a field acts: busy ones."""


def sticky(motion: Motion, truck: Truck, values: Values) -> Floats:
    """N that a trailer adds while it rolls, more as it goes faster."""
    return np.where(motion.speed > 0.0, 0.4 * np.asarray(values.get("drag", 0.0)) * (1.0 + motion.speed), 0.0)


def lamps(motion: Motion, truck: Truck, values: Values) -> Floats:
    """W while there is a load on the forks."""
    return np.where(motion.payload > 25.0, np.asarray(values.get("watts", 0.0)), 0.0)


def wet(motion: Motion, truck: Truck, values: Values) -> Floats:
    """A share of the speed that the road allows."""
    return np.asarray(values.get("share", 1.0) * motion.speed)


def odometer(motion: Motion, truck: Truck, values: Values) -> Floats:
    """The speed that a worn wheel shows."""
    return np.asarray(values.get("wear", 1.0) * motion.speed)


OWN = {
    "force": Term("trailer", "force", "a trailer drags", (Parameter("drag", "N", 0.0, 5000.0),), sticky,
                  depends_on=("speed",), sentence="The trailer drags with {drag.value:.0f} N", needs="drive without it"),
    "power": Term("lamps", "power", "lamps burn under load", (Parameter("watts", "W", 0.0, 9000.0),), lamps,
                  depends_on=("payload",), sentence="Lamps draw {watts.value:.0f} W", needs="switch them off"),
    "field": Term("mud", "force", "mud on the road", (Parameter("drag", "N", 0.0, 5000.0, usual=300.0),), sticky,
                  field=True, depends_on=("x", "y"), sentence="Mud drags {where}", needs="sweep the floor"),
    "speed": Term("wet", "speed", "drivers take it slowly in the wet",
                  (Parameter("share", "1", 0.05, 1.05, neutral=1.0, inverse=True),), wet, field=True,
                  depends_on=("x", "y"), sentence="Drivers take {share.value:.0%} of the speed {where}", needs="dry it"),
    "sensor": Term("worn", "sensor", "the wheel is worn", (Parameter("wear", "1", 0.5, 2.0, neutral=1.0, tolerance=0.01),),
                   odometer, fault="scale", depends_on=("speed",), sentence="The wheel reads {wear.value:.3f}", needs="measure"),
}  # fmt: skip
HIDDEN = {"force": 800.0, "power": 2500.0, "field": 1500.0, "speed": 0.5, "sensor": 1.06}
BESIDE = ("rolling_resistance", "auxiliary_load", "surface_resistance", "cornering_speed", "grade")


def recorded(kind: str, folder: Path) -> Dataset:
    """Forty minutes or more of three trucks with a user's own term in it."""
    term, network = OWN[kind], load_site(SAMPLE / "site.toml")[0].roads()
    name, value = term.parameters[0].name, HIDDEN[kind]
    hidden = Physics(TRUCK, {term.name: {name: value}})
    if term.field:
        where = np.array([network.edge(name) for name in ROADS], np.int32)
        there = stretches(
            network, where, np.zeros(len(where)), network.length[where], np.full(len(where), value)
        )
        hidden = Physics(TRUCK, fields={term.name: there})
    save_physics(folder, hidden if kind != "sensor" else Physics(TRUCK), network)
    # A wheel is measured on whole edges, of which a truck drives some twenty an hour.
    return simulated(folder, "day", 90 if kind == "sensor" else 40)


def simulated(folder: Path, name: str, minutes: int) -> Dataset:
    """A fleet under the model.toml of a folder."""
    fleetlog.simulate(
        site=SAMPLE / "site.toml", truck=SAMPLE / "truck.toml", vehicles=3, duration=f"{minutes}min", seed=4,
        physics=folder / "model.toml", recording=False, output=folder / name,
    )  # fmt: skip
    return Dataset(folder / name)


class Worn:
    """A dataset whose speed channel reads what the worn wheel shows."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __getattr__(self, name: str) -> object:
        return getattr(self.dataset, name)

    def here(self) -> Worn:
        return self

    def read(self, *what: object):
        t = self.dataset.read(*what)  # type: ignore[arg-type]
        return t.with_columns(speed=HIDDEN["sensor"] * t.floats("speed"))


def told(d: Diagnosis, dataset: Dataset, name: str) -> str:
    """The statement about a term, which stands in the page too."""
    (finding,) = [f for f in d.verdict.findings if f.term == name]
    page = diagnosis_page(d, as_result(d), dataset.site, dataset)
    assert finding.statement.split(" ")[0] in page
    assert as_result(d).shapes
    return finding.statement


@pytest.mark.parametrize("kind", list(OWN))
def test_a_term_of_a_users_own_is_found_written_simulated_drawn_and_worded(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    term = OWN[kind]
    monkeypatch.setitem(all_terms(), term.name, term)
    day = recorded(kind, tmp_path)
    seen = Worn(day) if kind == "sensor" else day
    channels = ("battery_power", "speed") if kind == "speed" else ("battery_power",)
    # A floor that is worse on the same roads says nearly the same as mud: it stays open, and may go first.
    beside = [t for t in BESIDE if kind != "field" or t != "surface_resistance"]
    with engines.using(1):
        found = diagnose(seen, TRUCK, channels=channels, terms=(term.name, *beside))  # type: ignore[arg-type]
    statement = told(found, day, term.name)
    assert statement.startswith(term.sentence.split("{")[0])
    first = found.verdict.findings[0].parameters[0]
    assert found.verdict.findings[0].term == term.name
    assert first.value == pytest.approx(HIDDEN[kind], rel=0.01 if kind == "sensor" else 0.3)
    if kind == "sensor":
        return
    (tmp_path / "found").mkdir()
    write_diagnosis(found, tmp_path / "found")
    assert term.name in tomllib.loads((tmp_path / "found" / "model.toml").read_text())["term"]
    written = load_physics(tmp_path / "found", TRUCK, day.site.network)
    again = simulated(tmp_path / "found", "again", 10)
    if term.acts in ("force", "power"):
        assert energy(again, TRUCK, written).summary["ledger_kwh"][term.name] > 0.0
    else:
        slow, free = (np.nanmax(d.read(d.vehicles[0]).floats("speed")) for d in (again, day))
        assert slow <= free
