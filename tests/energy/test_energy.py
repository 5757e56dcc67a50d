"""Energy by trip, vehicle, shift, hour, stretch and zone: it adds up, and it says what it used."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from shuttle import LENGTH, recorded, street, truth

from fleetlog.analysis.energy import energy
from fleetlog.cli.main import command_of
from fleetlog.core.motion import Motion
from fleetlog.core.result import EdgeValues, Result, Series
from fleetlog.core.site import Site, Zone
from fleetlog.core.trajectory import Labels
from fleetlog.core.truck import Truck
from fleetlog.physics.power import Physics, battery_power, ledger
from fleetlog.store.dataset import Dataset
from fleetlog.store.writer import DatasetWriter
from fleetlog.verbs.analyze import analyze


@pytest.fixture(scope="module")
def answer(day: tuple[Dataset, Motion], truck: Truck) -> Result:
    return energy(day[0], truck, shifts=(6, 14, 22))


def terms_of(table: pd.DataFrame) -> list[str]:
    return [c for c in table.columns if c.endswith("_kwh") and c.removesuffix("_kwh") in LEDGER]


LEDGER = {"inertia", "grade", "rolling_resistance", "aerodynamic_drag", "lift_efficiency", "auxiliary_load"}


def test_the_model_meets_the_measurement(day: tuple[Dataset, Motion], truck: Truck, answer: Result) -> None:
    exact = 2 * float(battery_power(day[1], Physics(truck)) @ day[1].dt) / 3.6e6
    summary = answer.summary
    assert summary["measured_kwh"] == pytest.approx(exact, rel=1e-3)
    assert summary["energy_kwh"] == pytest.approx(exact, rel=0.01)
    assert summary["difference_kwh"] == pytest.approx(
        summary["energy_kwh"] - summary["measured_kwh"], rel=1e-6
    )
    assert summary["distance_km"] == pytest.approx(2 * 24 * street().length[0] / 1000.0, rel=0.005)
    trips = answer.tables["energy_trips"]
    assert len(trips) == 48
    assert np.all(np.abs(trips["difference_kwh"]) < 0.02 * trips["measured_kwh"])


def test_the_ledger_is_that_of_the_truth(day: tuple[Dataset, Motion], truck: Truck, answer: Result) -> None:
    exact = {k: 2 * float(v @ day[1].dt) / 3.6e6 for k, v in ledger(day[1], Physics(truck)).items()}
    for name, kwh in exact.items():
        assert answer.summary["ledger_kwh"][name] == pytest.approx(kwh, abs=0.01 * sum(exact.values())), name


@pytest.mark.parametrize("name", ["trips", "vehicles", "shifts", "hours"])
def test_every_ledger_adds_up_and_every_table_to_the_whole(answer: Result, name: str) -> None:
    table = answer.tables[f"energy_{name}"]
    assert len(terms_of(table)) == len(LEDGER)
    assert np.allclose(table[terms_of(table)].sum(axis=1), table["energy_kwh"], rtol=1e-9)
    for column in ("energy_kwh", "measured_kwh", "distance_km", "duration_h", "regenerated_kwh"):
        assert table[column].sum() == pytest.approx(answer.summary[column], rel=1e-9), column


def test_hours_and_shifts_are_cut_where_the_clock_says(answer: Result) -> None:
    hours = answer.tables["energy_hours"]
    assert [h.hour for h in hours["hour"]] == [5, 6, 7][: len(hours)]
    shifts = answer.tables["energy_shifts"].set_index("shift")
    assert set(shifts.index) == {"22-06", "06-14"}
    assert shifts.loc["22-06", "energy_kwh"] == pytest.approx(hours["energy_kwh"].iloc[0])
    assert shifts.loc["22-06", "duration_h"] == pytest.approx(2 * 20 / 60, rel=1e-3)


def test_laden_uphill_costs_more_than_empty_downhill(answer: Result) -> None:
    trips = answer.tables["energy_trips"]
    out, back = trips[trips["trip_id"] % 2 == 0], trips[trips["trip_id"] % 2 == 1]
    assert (out["grade_kwh"] > 0).all() and (back["grade_kwh"] < 0).all()
    assert out["kwh_per_km"].min() > 1.5 * back["kwh_per_km"].max()
    assert back["kwh_per_tkm"].isna().all()  # nothing was carried
    tkm = 1.5 * out["distance_km"]
    assert np.allclose(out["kwh_per_tkm"], out["energy_kwh"] / tkm, rtol=1e-3)


def test_stretches_carry_the_hill_in_their_direction(answer: Result) -> None:
    table = answer.places["energy_edges"]
    hill = table[(table["from"] == 50.0)]
    up, down = (float(hill.loc[hill["edge_id"] == e, "joules_per_metre"].iloc[0]) for e in ("a", "-a"))
    flat = float(table.loc[(table["edge_id"] == "a") & (table["from"] == 90.0), "joules_per_metre"].iloc[0])
    assert up > flat > down
    # m g sin(theta) / efficiency on top of the flat, in newtons
    assert up - flat == pytest.approx((3830.0 + 1500.0) * 9.81 * 0.03 / 0.72, rel=0.05)
    shape = next(s for s in answer.shapes if isinstance(s, EdgeValues))
    assert len(shape.values) == len(table)


def test_a_zone_holds_what_is_spent_in_it(day: tuple[Dataset, Motion], truck: Truck, answer: Result) -> None:
    motion = day[1]
    zone = answer.tables["energy_zones"].iloc[0]
    inside = (motion.x >= 40) & (motion.x < 80)
    joules = battery_power(motion, Physics(truck)) * motion.dt
    assert zone["energy_kwh"] == pytest.approx(2 * joules[inside].sum() / 3.6e6, rel=0.02)
    assert zone["distance_km"] == pytest.approx(2 * 24 * 40.01 / 1000.0, rel=0.01)


def test_curves_stack_to_the_total(answer: Result) -> None:
    stacked = next(s for s in answer.shapes if isinstance(s, Series) and s.stacked)
    step = float(np.diff(stacked.x).min()) * 1e-6
    assert sum(y.sum() for y in stacked.y.values()) * step / 3600.0 == pytest.approx(
        answer.summary["energy_kwh"], rel=1e-9
    )


def test_state_of_charge_at_both_ends_and_regeneration(answer: Result, truck: Truck) -> None:
    vehicles = answer.tables["energy_vehicles"].set_index("vehicle_id")
    used = (
        (vehicles.loc["T1", "soc_start"] - vehicles.loc["T1", "soc_end"]) * truck.battery.capacity_wh / 1000.0
    )
    assert used == pytest.approx(vehicles.loc["T1", "measured_kwh"], rel=0.01)
    assert 0.0 < answer.summary["regenerated_kwh"] < 0.2 * answer.summary["energy_kwh"]


def test_the_stated_doubt_covers_a_truck_whose_numbers_are_off(
    day: tuple[Dataset, Motion], truck: Truck, answer: Result
) -> None:
    one = truck.with_value("resistance.rolling", truck.resistance.rolling * 1.35)
    moved = energy(day[0], one).summary["energy_kwh"] - answer.summary["energy_kwh"]
    roll = 0.35 * answer.summary["ledger_kwh"]["rolling_resistance"]
    assert moved == pytest.approx(roll, rel=0.1)
    # All numbers together doubt at least as much as rolling alone, and an interval in the model narrows it.
    assert answer.summary["deviation_kwh"] > 0.95 * roll
    sure = Physics(truck, intervals={"rolling_resistance": {"coefficient": (0.0179, 0.0181)}})
    assert energy(day[0], truck, sure).summary["deviation_kwh"] < 0.9 * answer.summary["deviation_kwh"]


def test_found_physics_enters_the_ledger(day: tuple[Dataset, Motion], truck: Truck, answer: Result) -> None:
    found = energy(day[0], truck, Physics(truck, {"viscous_drag": {"coefficient": 60.0}}))
    extra = found.summary["ledger_kwh"]["viscous_drag"]
    assert extra > 0.0
    assert sum(found.summary["ledger_kwh"].values()) == pytest.approx(found.summary["energy_kwh"], rel=1e-9)
    assert found.summary["energy_kwh"] - answer.summary["energy_kwh"] == pytest.approx(extra, rel=0.2)


def variant(tmp_path: Path, truck: Truck, **change: str) -> Dataset:
    """The same day with other electrical channels."""
    network = street()
    motion, _ = truth(truck, network, 8)
    power = battery_power(motion, Physics(truck))
    log = recorded(motion, "T1", power, network)
    columns = {k: v for k, v in log.columns.items() if k != "battery_power"}
    if "voltage" in change.values():
        columns |= {"battery_voltage": np.full(len(power), 80.0), "battery_current": power / 80.0}
    if "soc" in change.values():
        columns["soc"] = 0.9 - np.cumsum(power * motion.dt) / (3600.0 * truck.battery.capacity_wh)
    with DatasetWriter.create(tmp_path / "d", "recorded", Site("street", network=network)) as writer:
        writer.write(type(log)("T1", log.time, columns))
    return Dataset(tmp_path / "d")


@pytest.mark.parametrize(
    ("channel", "source"), [("voltage", "voltage and current"), ("soc", "soc"), ("none", "nothing")]
)
def test_it_says_what_the_measured_energy_was_taken_from(
    tmp_path: Path, truck: Truck, channel: str, source: str
) -> None:
    found = energy(variant(tmp_path, truck, channel=channel), truck)
    assert list(found.summary["measured_from"]) == [source]
    if source == "nothing":
        assert np.isnan(found.summary["measured_kwh"])
        assert "no electrical channel" in " ".join(found.lines)
    else:
        assert found.summary["measured_kwh"] == pytest.approx(found.summary["energy_kwh"], rel=0.02)


def test_points_of_a_polygon() -> None:
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    x, y = np.array([1.0, 3.0, -1.0, 1.0, 0.5]), np.array([1.0, 1.0, 1.0, 3.0, 1.9])
    assert Zone("z", square).contains(x, y).tolist() == [True, False, False, False, True]
    closed = np.vstack([square, square[:1]])
    assert Zone("z", closed).contains(x, y).tolist() == [True, False, False, False, True]


def test_the_command_writes_everything(day: tuple[Dataset, Motion], tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = [str(day[0].path), "--truck", "counterbalance-2.5t", "-o", str(out), "--json"]
    done = CliRunner().invoke(command_of(analyze.energy), arguments)
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["trips"] == 48 and LENGTH == 120.0
    names = {p.name for p in out.iterdir()}
    assert {
        "energy.json",
        "energy_trips.parquet",
        "energy_edges.parquet",
        "energy.png",
        "recording.rrd",
    } <= names


def test_a_battery_that_cannot_give_the_power_is_reported(
    day: tuple[Dataset, Motion], truck: Truck, answer: Result
) -> None:
    assert answer.summary["collapsed_s"] == 0.0 and "collapses" not in " ".join(answer.lines)
    weak = energy(day[0], truck.with_value("battery.internal_resistance", 0.2), chemistry="lead")
    assert weak.summary["collapsed_s"] > 0.0
    assert any("The voltage collapses" in line for line in weak.lines)
    trips = weak.tables["energy_trips"]
    assert np.isfinite(trips["lowest_voltage_v"]).all() and np.isfinite(trips["soc_end_model"]).all()
    assert (trips["soc_end_model"] < trips["soc_start"]).all()
    # The file's own small resistance takes next to nothing: the model's charge ends where the log's does.
    calm = answer.tables["energy_trips"]
    assert np.allclose(calm["soc_end_model"], calm["soc_end"], atol=2e-4)


@pytest.mark.parametrize("channel", ["battery_power", "soc"])
def test_what_a_charger_gives_is_charged_and_not_used(tmp_path: Path, truck: Truck, channel: str) -> None:
    seconds, watts, capacity = 1200, 6000.0, truck.battery.capacity_wh * 3600.0
    whole = variant(tmp_path / "day", truck, channel="soc" if channel == "soc" else "none")
    log = next(iter(whole.days(("x", "y", "speed", "payload", "fork_height", channel))))
    columns = {n: np.asarray(v) for n, v in log.columns.items() if not isinstance(v, Labels)}
    columns |= {} if channel == "soc" else {"battery_power": np.full(len(log), 900.0)}
    plugged = {n: np.repeat(v[-1:], seconds) for n, v in columns.items()} | {"speed": np.zeros(seconds)}
    plugged[channel] = columns[channel][-1] + watts / capacity * np.arange(1, seconds + 1) if (
        channel == "soc"
    ) else np.full(seconds, -watts)  # fmt: skip
    time = np.append(log.time, log.time[-1] + np.arange(1, seconds + 1) * 1_000_000)
    joined = {n: np.concatenate([columns[n], plugged[n]]) for n in columns}

    def summary(name: str, rows: int) -> dict[str, Any]:
        with DatasetWriter.create(tmp_path / name, "recorded", whole.site) as writer:
            writer.write(type(log)("T1", time[:rows], {n: v[:rows] for n, v in joined.items()}))
        return energy(Dataset(tmp_path / name), truck).summary

    before, after = summary("before", len(log)), summary("after", len(time))
    assert after["charged_kwh"] == pytest.approx(watts * seconds / 3.6e6, rel=0.01)
    assert after["energy_kwh"] == pytest.approx(before["energy_kwh"], rel=0.01)
    assert after["measured_kwh"] == pytest.approx(before["measured_kwh"], rel=0.01)
