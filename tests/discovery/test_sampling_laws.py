"""What sampling hides is measured on the recording: the scatter of rows, and what half of them would change."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fleetlog
from fleetlog.core.truck import load_truck
from fleetlog.discovery.channels.base import Unit
from fleetlog.discovery.channels.choose import channel_of
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.model import Model
from fleetlog.discovery.recording.blocks import Windows, block, merged
from fleetlog.discovery.recording.day import Day, held
from fleetlog.discovery.recording.fleet import Fleet, read_fleet
from fleetlog.discovery.recording.sensors import examine
from fleetlog.discovery.recording.splits import make_split
from fleetlog.discovery.search.joint import SETTLED, moved, refit
from fleetlog.discovery.search.problem import Noise, Problem, learn
from fleetlog.discovery.settings import SETTINGS
from fleetlog.store import Dataset

WINDOWS = 3000
TRUCK = load_truck(Path(__file__).parents[2] / "sample_data" / "truck.toml")


def learnt(exponent: float, seed: int) -> Noise:
    """The noise of windows whose variance grows with this power of the scatter of their rows."""
    rng = np.random.default_rng(seed)
    count = np.arange(WINDOWS)
    swing, level = np.exp(rng.normal(0.0, 0.8, WINDOWS)), rng.uniform(20.0, 60.0, WINDOWS)
    windows = Windows(
        trip=count // 10, vehicle=np.zeros(WINDOWS, int), day=np.zeros(WINDOWS, int), edge=count,
        duration=np.full(WINDOWS, 10.0), distance=np.full(WINDOWS, 20.0), x=level, y=level, time=count * 10.0,
    )  # fmt: skip
    recorded = level + rng.normal(0.0, 1.0, WINDOWS) * swing ** (exponent / 2.0)
    whole = np.ones(WINDOWS, bool)
    unit = Unit(windows, recorded, whole, np.zeros(WINDOWS), level, swing, np.zeros(WINDOWS, int), None)
    table = (unit, level, rng.normal(size=(WINDOWS, 2)).astype(np.float32))
    return learn([table], SETTINGS, 0.0, lambda w: w.trip)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_the_power_by_which_noise_grows_with_the_scatter_of_rows_is_measured(exponent: float) -> None:
    assert learnt(exponent, 3).exponent == pytest.approx(exponent, abs=0.25)


def test_weights_are_the_inverse_of_the_variance_that_was_put_in() -> None:
    noise = learnt(2.0, 5)
    one, two = (float(noise.plain(unit)[0]) for unit in (_single(1.0), _single(4.0)))
    assert one / two == pytest.approx(16.0, rel=0.3)
    assert one == pytest.approx(1.0, rel=0.2)


def test_noise_is_no_less_where_the_freest_model_has_a_column_for_every_window() -> None:
    """Windows that it has seen a fit with as many columns follows; of one that it has not it knows nothing."""
    count = np.arange(300)
    level = np.full(300, 40.0)
    windows = Windows(
        trip=count, vehicle=np.zeros(300, int), day=np.zeros(300, int), edge=count, duration=np.full(300, 10.0),
        distance=np.full(300, 20.0), x=level, y=level, time=count * 10.0,
    )  # fmt: skip
    recorded, whole = level + np.random.default_rng(1).normal(0.0, 2.0, 300), np.ones(300, bool)
    unit = Unit(windows, recorded, whole, np.zeros(300), level, np.ones(300), np.zeros(300, int), None)
    noise = learn([(unit, level, np.eye(300, dtype=np.float32))], SETTINGS, 0.0, lambda w: w.trip)
    assert np.mean(1.0 / noise.plain(unit)) > 3.0


def _single(swing: float) -> Unit:
    w = Windows(*(np.array([v]) for v in (0, 0, 0, 0, 10.0, 20.0, 0.0, 0.0, 0.0)))
    return Unit(
        w,
        np.array([40.0]),
        np.ones(1, bool),
        np.zeros(1),
        np.array([40.0]),
        np.array([swing]),
        np.zeros(1, int),
        None,
    )


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An hour of three trucks of the sample plant, with nothing concealed."""
    out = tmp_path_factory.mktemp("sampling") / "day"
    root = Path(__file__).parents[2] / "sample_data"
    fleetlog.simulate(
        site=root / "site.toml", truck=root / "truck.toml", vehicles=3, duration="1h", seed=4, recording=False,
        output=out,
    )  # fmt: skip
    return out


def test_the_models_own_error_grows_as_rows_become_rarer(simulated: Path) -> None:
    fleet = read_fleet(Dataset(simulated), TRUCK)
    split = make_split("trips", fleet.trips, fleet.seconds, [0, 1, 2], [0], 10, 0.2, 0)
    base, errors = Model(TRUCK), []
    for every in (1, 2, 5):
        rarer = replace(fleet, days=[Day(d.vehicle, d.load()[::every]) for d in fleet.days])
        errors.append(channel_of("battery_power", rarer, base, SETTINGS, split).model_error)
    assert errors[0] < 0.04
    assert errors[0] <= errors[1] < errors[2]


def test_a_field_fitted_again_and_again_stays_what_its_prior_allows(simulated: Path) -> None:
    fleet = read_fleet(Dataset(simulated), TRUCK)
    split = make_split("trips", fleet.trips, fleet.seconds, [0, 1, 2], [0], 10, 0.2, 0)
    base = Model(TRUCK)
    problem = Problem(channel_of("battery_power", fleet, base, SETTINGS, split), split, SETTINGS, ())
    field = Hypothesis("grade", field=True, variance=1e-4)
    joint, sizes = refit(problem, base, [field], 1), []
    for _ in range(6):
        sizes.append(float(np.linalg.norm(joint.model.fields["grade"])))
        joint = refit(problem, joint.model, [field], 1)
    assert sizes[0] > 0.0
    assert sizes == pytest.approx([sizes[0]] * 6, rel=0.1)


@pytest.fixture(scope="module")
def less_accelerated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with accelerations that take 4 % less force than the weighed mass says, as sampling may have it."""
    out = tmp_path_factory.mktemp("settling")
    root = Path(__file__).parents[2] / "sample_data"
    (out / "model.toml").write_text("[term.rotational_inertia]\nfactor = 0.96\n", encoding="utf-8")
    fleetlog.simulate(
        site=root / "site.toml", truck=root / "truck.toml", vehicles=3, duration="1h", seed=4, recording=False,
        physics=out / "model.toml", output=out / "day",
    )  # fmt: skip
    return out / "day"


@pytest.mark.parametrize("channel", ["battery_power", "speed"])
def test_a_fit_settles_on_one_model(less_accelerated: Path, channel: str) -> None:
    """Numbers of the truck file stand where the next step leaves them, beyond the bounds of findings, too; what
    only caps a speed stands no higher than where it does nothing."""
    fleet = read_fleet(Dataset(less_accelerated), TRUCK)
    split = make_split("trips", fleet.trips, fleet.seconds, [0, 1, 2], [0], 10, 0.2, 0)
    problem = Problem(channel_of(channel, fleet, Model(TRUCK), SETTINGS, split), split, SETTINGS, ())
    settled = refit(problem, Model(TRUCK), [])
    assert moved(refit(problem, settled.model, [], 1), problem)[1] < SETTLED
    if channel == "battery_power":
        assert settled.model.values()["rotational_inertia"]["factor"] == pytest.approx(0.96, abs=0.02)
    else:
        assert settled.model.values()["laden_speed"]["factor"] <= 1.0


@pytest.mark.parametrize("interval", [3, 5])
def test_rows_whose_power_is_a_mean_say_their_energy_once(simulated: Path, interval: int) -> None:
    """Of a mean over the last seconds the energy of windows is exact, whatever happened within the interval."""
    dataset = Dataset(simulated)
    trajectory = dataset.read(dataset.vehicles[0], dataset.dates[0])
    exact = trajectory.floats("battery_power")
    sums = np.cumsum(exact)
    mean = (sums - np.concatenate([np.zeros(interval), sums[:-interval]])) / interval
    told = trajectory.with_columns(battery_power=mean)
    made = merged(block(told, 0, dataset.site.network, TRUCK), float(interval))
    rows = np.flatnonzero(np.isfinite(made.power))[1:]
    assert len(made) == pytest.approx(len(exact) / interval, rel=0.2)
    last = np.searchsorted(trajectory.time * 1e-6, made.time[rows] + 0.5 * (interval - 1) - 0.1)
    energy = [exact[i - interval + 1 : i + 1].sum() for i in last]
    assert made.power[rows] * interval == pytest.approx(energy, rel=1e-6, abs=1.0)


def repeated(dataset: Dataset, rows: int, mean: bool = False) -> Fleet:
    """The fleet, its power new on every so many rows only: what it was then, or on average since the last."""
    days = []
    for day in read_fleet(dataset, TRUCK).days:
        trajectory = day.load()
        power = trajectory.floats("battery_power")
        first = np.arange(len(power)) // rows * rows
        if mean:
            total = np.concatenate([[0.0], np.cumsum(power)])
            power = (total[first + 1] - total[np.maximum(first + 1 - rows, 0)]) / rows
        told = trajectory.with_columns(battery_power=power if mean else power[first])
        days.append(Day(day.vehicle, told))
    held = {d.vehicle: d.held for d in days if d.held}
    return replace(read_fleet(dataset, TRUCK), days=days, held=held)


@pytest.mark.parametrize("rows", [2, 4])
def test_a_power_that_is_repeated_is_no_fault_of_its_clock(simulated: Path, rows: int) -> None:
    fleet = repeated(Dataset(simulated), rows)
    assert fleet.held == dict.fromkeys(range(3), rows * fleet.step)
    split = make_split("trips", fleet.trips, fleet.seconds, [0, 1, 2], [0], 10, 0.2, 0)
    mended, faults = examine(fleet, split)
    assert faults == []
    # What a value stands for begins half its time before the row that has it first.
    assert mended.lag == pytest.approx(dict.fromkeys(range(3), 0.5 * (rows - 1) * fleet.step))


def test_a_mean_that_is_repeated_is_a_mean_of_that_time(simulated: Path) -> None:
    fleet = repeated(Dataset(simulated), 4, mean=True)
    split = make_split("trips", fleet.trips, fleet.seconds, [0, 1, 2], [0], 10, 0.2, 0)
    (fault,) = examine(fleet, split)[1]
    # Four moments span three steps, or four with the time that each stands for.
    assert (fault.term, fault.off.value) == ("averaging", pytest.approx(3.5 * fleet.step, abs=0.6))


@pytest.mark.parametrize("step", [0.0, 100.0, 500.0])
def test_coarse_steps_are_no_repetition(simulated: Path, step: float) -> None:
    day = read_fleet(Dataset(simulated), TRUCK).days[0].load()
    power = day.floats("battery_power")
    assert held(day.with_columns(battery_power=np.round(power / step) * step if step else power)) == 0.0
