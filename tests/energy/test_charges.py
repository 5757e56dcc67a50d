"""What a charge is, and what it is not, whatever the log saw of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shuttle import recorded, street, truth

from fleetlog.analysis.energy import energy
from fleetlog.analysis.utilisation import utilisation
from fleetlog.core.motion import Motion
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck
from fleetlog.physics.power import Physics, battery_power
from fleetlog.store.dataset import Dataset
from fleetlog.store.trips import trip_ids
from fleetlog.store.writer import DatasetWriter

HOUR = 3600
PAUSE = 4 * HOUR  # Between two halves of a day [s]


def written(path: Path, t: Trajectory) -> Dataset:
    with DatasetWriter.create(path, "recorded", Site("street", network=street())) as writer:
        writer.write(t)
    return Dataset(path)


def driven(truck: Truck, *channels: str) -> Trajectory:
    """Sixteen trips of a nominal truck, with these of the channels ``battery_power`` and ``soc``."""
    motion, _ = truth(truck, network := street(), 16)
    power = battery_power(motion, Physics(truck))
    soc = 0.5 - np.cumsum(power * motion.dt) / (3600.0 * truck.battery.capacity_wh)
    log = recorded(motion, "T1", power, network, soc=soc)
    return log.without(*({"battery_power", "soc"} - set(channels)))


def paused(log: Trajectory, every: int | None, rise: float, shift: int = 0) -> Trajectory:
    """The log with a pause in the middle, in which the state of charge changes; a row ``every`` seconds."""
    still = np.flatnonzero(log.floats("speed") == 0.0)
    at = int(still[np.argmin(np.abs(still - len(log) // 2))])
    when = np.arange(every, PAUSE, every) if every else np.zeros(0, int)
    row = np.concatenate([np.arange(at + 1), np.full(len(when), at), np.arange(at + 1, len(log))])
    out, added = log[row], np.repeat([0.0, 1.0], [at + 1, len(row) - at - 1])
    added[at + 1 : at + 1 + len(when)] = when / PAUSE
    time = log.time[row] + (added * PAUSE * 1e6).astype(np.int64) + shift * 1_000_000
    columns: dict[str, Any] = {"soc": out.floats("soc") + rise * added}
    if "battery_power" in out:
        power = out.floats("battery_power").copy()
        power[at + 1 : at + 1 + len(when)] = np.nan
        columns["battery_power"] = power
    made = Trajectory(log.vehicle_id, time, {**out.columns, **columns})
    return made.with_columns(trip_id=trip_ids(made))


@pytest.mark.parametrize("shift", [0, 15 * HOUR])
@pytest.mark.parametrize("every", [None, HOUR, 300, 1])
@pytest.mark.parametrize("channels", [("soc",), ("soc", "battery_power")])
def test_a_charge_is_one_however_much_of_it_the_log_saw(
    tmp_path: Path, truck: Truck, channels: tuple[str, ...], every: int | None, shift: int
) -> None:
    log = driven(truck, *channels)
    bare = energy(written(tmp_path / "bare", log), truck).summary
    d = written(tmp_path / "paused", paused(log, every, 0.3, shift))
    found = energy(d, truck)
    s, capacity = found.summary, truck.battery.capacity_wh / 1000.0
    assert s["charged_kwh"] == pytest.approx(0.3 * capacity, rel=0.01)
    assert s["measured_kwh"] == pytest.approx(bare["measured_kwh"], rel=0.01)
    assert s["energy_kwh"] == pytest.approx(bare["energy_kwh"], rel=0.01)
    assert s["soc_end_model"] == pytest.approx(s["soc_end"], abs=0.001)
    trips = found.tables["energy_trips"]
    assert trips["measured_kwh"].min() > 0.0
    assert np.allclose(trips["soc_end_model"], trips["soc_end"], atol=0.001) or every == 1
    states = utilisation(d).tables["states"]
    assert (states["charged"] & ~states["charged"].shift(fill_value=False)).sum() == 1
    hours = utilisation(d).summary["hours"]
    # Where the log is silent, it is charging between two rows that it rose before and after.
    unseen = PAUSE if every is None else 2 * every if every > 60 else 0
    assert hours["charging"] * HOUR == pytest.approx(PAUSE - unseen, abs=2.0 * (every or 1))


@pytest.mark.parametrize("change", [-0.02, 0.003])
def test_what_changes_in_a_silence_is_no_trips(tmp_path: Path, truck: Truck, change: float) -> None:
    log = driven(truck, "soc")
    bare, s = (
        energy(written(tmp_path / name, t), truck).summary
        for name, t in (("bare", log), ("paused", paused(log, None, change)))
    )
    assert s["charged_kwh"] == 0.0 and s["measured_kwh"] == pytest.approx(bare["measured_kwh"], rel=0.01)
    assert s["soc_end"] - s["soc_end_model"] == pytest.approx(change, abs=0.001)


def test_midnight_loses_nothing(tmp_path: Path, truck: Truck) -> None:
    log = driven(truck, "battery_power")
    half = int(log.time[len(log) // 2])
    midnight = -(-half // 86_400_000_000) * 86_400_000_000
    moved = Trajectory("T1", log.time + midnight - half - 500_000, log.columns)
    one, two = (energy(written(tmp_path / n, t), truck).summary for n, t in (("a", log), ("b", moved)))
    assert len(Dataset(tmp_path / "b").dates) == 2
    for name in ("duration_h", "measured_kwh", "trips"):
        assert one[name] == pytest.approx(two[name], rel=1e-9)
    assert two["energy_kwh"] == pytest.approx(one["energy_kwh"], rel=1e-3)


def test_the_source_is_that_of_each_trip(tmp_path: Path, truck: Truck) -> None:
    log = driven(truck, "battery_power")
    trip = log.trip_ids()
    power = np.where(trip < 5, log.floats("battery_power"), np.nan)
    half = written(tmp_path / "half", log.with_columns(battery_power=power))
    found = energy(half, truck)
    assert found.summary["measured_from"] == {"power": 5, "nothing": 11}
    assert found.tables["energy_trips"]["measured_kwh"].notna().sum() == 5


def test_the_charge_of_the_model_ends_where_its_own_use_leads(
    day: tuple[Dataset, Motion], truck: Truck
) -> None:
    wrong = truck.with_value("resistance.rolling", 2.0 * truck.resistance.rolling)
    found = energy(day[0], wrong)
    vehicles = found.tables["energy_vehicles"]
    used = (vehicles["energy_kwh"] + vehicles["battery_loss_kwh"]) / truck.battery.capacity_wh * 1000.0
    assert np.allclose(vehicles["soc_end_model"], vehicles["soc_start"] - used, atol=1e-3)
    assert (vehicles["soc_end"] - vehicles["soc_end_model"] > 0.005).all()
    # Two trucks have no one charge.
    for table in (found.tables["energy_shifts"], found.tables["energy_hours"]):
        assert table[["soc_start", "soc_end", "soc_end_model"]].isna().all(axis=None)
    assert found.summary["soc_end"] is None


def test_power_of_the_other_sign_is_told(tmp_path: Path, truck: Truck) -> None:
    log = driven(truck, "battery_power")
    right = written(tmp_path / "right", log)
    wrong = written(tmp_path / "wrong", log.with_columns(battery_power=-log.floats("battery_power")))
    assert not any("scale = -1" in line for line in energy(right, truck).lines)
    assert "Battery power of T1 is negative while driving" in energy(wrong, truck).lines[-1]
