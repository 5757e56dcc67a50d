"""Laws of the whole diagnosis: what is held out only scores, errors are those of model.toml."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from seen import Seen

import fleetlog
from fleetlog.analysis.energy import energy
from fleetlog.core.network import Network, build_network
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import load_truck
from fleetlog.discovery.channels.energy import EnergyChannel
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.recording.blocks import DAY, TRIP
from fleetlog.discovery.recording.splits import HELD_OUT
from fleetlog.discovery.report.output import write_diagnosis
from fleetlog.physics.field import stretches
from fleetlog.physics.model import load_physics, save_physics
from fleetlog.physics.power import Physics, battery_power
from fleetlog.roads import load_site
from fleetlog.store import Dataset

SAMPLE = Path(__file__).parents[2] / "sample_data"
TRUCK = load_truck(SAMPLE / "truck.toml")
FACTOR, ROADS = 3.0, 6
"""Of the rolling resistance on the roads that are driven most."""
TERMS = ("surface_resistance", "rolling_resistance", "grade", "auxiliary_load")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """An hour of three trucks of the sample plant, with a bad floor on some roads."""
    folder = tmp_path_factory.mktemp("law")
    network = load_site(SAMPLE / "site.toml")[0].roads()
    bad = np.arange(ROADS, dtype=np.int32)
    field = stretches(network, bad, np.zeros(ROADS), network.length[bad], np.full(ROADS, FACTOR))
    save_physics(folder, Physics(TRUCK, fields={"surface_resistance": field}), network)
    fleetlog.simulate(
        site=SAMPLE / "site.toml", truck=SAMPLE / "truck.toml", vehicles=3, duration="1h", seed=5,
        physics=folder / "model.toml", recording=False, output=folder / "day",
    )  # fmt: skip
    return Dataset(folder / "day")


def judged(dataset: Dataset | Seen) -> Diagnosis:
    return diagnose(dataset, TRUCK, channels=("battery_power",), terms=TERMS)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def found(recorded: Dataset) -> Diagnosis:
    return judged(recorded)


def test_what_is_more_than_chance_but_moves_too_little_is_no_finding_and_is_said(tmp_path: Path) -> None:
    save_physics(tmp_path, Physics(TRUCK, {"copper_loss": {"k": 1.6e-5}}))
    fleetlog.simulate(
        site=SAMPLE / "site.toml", truck=SAMPLE / "truck.toml", vehicles=3, duration="1h", seed=4, rate=5.0,
        physics=tmp_path / "model.toml", recording=False, output=tmp_path / "day",
    )  # fmt: skip
    d = diagnose(Dataset(tmp_path / "day"), TRUCK, channels=("battery_power",))
    assert (d.verdict.word, d.verdict.findings) == ("none", [])
    said = [n for n in d.verdict.notes if "significant but small" in n]
    assert len(said) == 1 and re.match(r"battery_power: copper_loss .*: 1\.\d % .* begin at 2 %", said[0])


def told(d: Diagnosis) -> list[tuple[object, ...]]:
    """All that a diagnosis says but for its scores."""
    return [(f.term, f.statement, f.where, f.scope, f.parameters, f.not_excluded) for f in d.verdict.findings]


def test_the_bad_floor_is_found(found: Diagnosis) -> None:
    """Else the laws below would say nothing."""
    assert [f.term for f in found.verdict.findings] == ["surface_resistance"]


def test_noise_in_what_is_held_out_changes_the_scores_alone(recorded: Dataset, found: Diagnosis) -> None:
    split = found.channels["battery_power"].problem.split
    names = found.fleet.vehicles

    def noisy(t: Trajectory) -> Trajectory:
        v = names.index(t.vehicle_id)
        fold = split.rows(t.trip_ids() + TRIP * v, t.time * 1e-6, v, int(t.time[0] // DAY))
        noise = 1e7 * np.random.default_rng(3).normal(size=len(t))
        return t.with_columns(
            battery_power=t.floats("battery_power") + np.where(fold == HELD_OUT, noise, 0.0)
        )

    other = judged(Seen(recorded, noisy, recorded.site))
    assert other.verdict.channels[0].after > 2.0 * found.verdict.channels[0].after
    assert told(other) == told(found)
    assert other.verdict.adjustments == found.verdict.adjustments


def test_nothing_is_said_to_be_missing_where_noise_hides_all(recorded: Dataset) -> None:
    """Of power without the sixth part of it that the bad floor takes; the rest is noise."""

    def drowned(t: Trajectory) -> Trajectory:
        noise = 5e5 * np.random.default_rng(len(t)).normal(size=len(t))
        return t.with_columns(battery_power=t.floats("battery_power") + noise)

    verdict = judged(Seen(recorded, drowned, recorded.site)).verdict
    assert verdict.word == "unknown"
    assert not verdict.findings
    assert "noise hides" in (verdict.channels[0].reason or "")


def test_reported_errors_are_those_of_the_model_that_is_written(
    recorded: Dataset, found: Diagnosis, tmp_path: Path
) -> None:
    write_diagnosis(found, tmp_path)
    written = load_physics(tmp_path / "model.toml", TRUCK, recorded.site.network)
    problem = found.channels["battery_power"].problem
    channel = problem.channel
    assert isinstance(channel, EnergyChannel)
    off, size, modelled = 0.0, 0.0, {}
    for unit in problem.held_out():
        block = unit.own.block
        own = written.of(found.fleet.vehicles[block.vehicle], block.time[0])
        power = battery_power(block.motion, own)
        left = (unit.recorded - unit.own.energy(power))[unit.whole]
        off, size = off + float(left @ left), size + float((unit.recorded[unit.whole] ** 2).sum())
        of_trip = np.bincount(block.trip[block.row] % TRIP, power * block.motion.dt) / 3.6e6
        modelled |= {
            (found.fleet.vehicles[block.vehicle], k): of_trip[k]
            for k in np.unique(unit.windows.trip[unit.whole] % TRIP).tolist()
        }
    assert np.sqrt(off / size) == pytest.approx(found.verdict.channels[0].after, rel=0.01)
    trips = energy(recorded, TRUCK, written).tables["energy_trips"].set_index(["vehicle_id", "trip_id"])
    assert len(modelled) >= 5
    analysed = trips.loc[list(modelled), "energy_kwh"].to_numpy()
    diagnosed = np.array(list(modelled.values()))
    assert analysed.sum() == pytest.approx(diagnosed.sum(), rel=2e-3)
    # A lift between two rows may be part of either trip, and the analysis reads a day in pieces.
    assert analysed == pytest.approx(diagnosed, rel=0.02)


def framed(dataset: Dataset, angle: float, mirror: float) -> Seen:
    """The recording on a site that is turned, mirrored and shifted."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ np.diag(
        [1.0, mirror]
    )

    def placed(points: np.ndarray) -> np.ndarray:
        return np.column_stack([points[:, :2] @ turn.T + [300.0, -70.0], points[:, 2:]])

    def change(t: Trajectory) -> Trajectory:
        x, y = placed(np.column_stack([t.floats("x"), t.floats("y")])).T
        heading = angle + mirror * t.floats("heading")
        return t.with_columns(x=x, y=y, heading=heading, lateral_offset=mirror * t.floats("lateral_offset"))

    return Seen(dataset, change, replace(dataset.site, network=_moved(dataset.site.roads(), placed)))


def _moved(network: Network, placed: Callable[[np.ndarray], np.ndarray]) -> Network:
    return build_network([replace(e, points=placed(e.points)) for e in network.edges()])


@pytest.mark.parametrize(("angle", "mirror"), [(np.pi / 2.0, -1.0), (0.7, 1.0)])
def test_turning_mirroring_and_shifting_the_site_changes_no_answer(
    recorded: Dataset, found: Diagnosis, angle: float, mirror: float
) -> None:
    other = judged(framed(recorded, angle, mirror))
    for a, b in zip(found.verdict.findings, other.verdict.findings, strict=True):
        assert (a.term, a.scope, a.not_excluded) == (b.term, b.scope, b.not_excluded)
        assert a.where is not None and b.where is not None
        assert [e["edge_id"] for e in a.where["edges"]] == [e["edge_id"] for e in b.where["edges"]]
        for p, q in zip(a.parameters, b.parameters, strict=True):
            assert (q.value, q.low, q.high) == pytest.approx((p.value, p.low, p.high), rel=0.01)
    (one,), (two,) = found.verdict.channels, other.verdict.channels
    assert (two.before, two.after, two.floor) == pytest.approx((one.before, one.after, one.floor), rel=0.01)
