"""Vehicles and logs that are not those of a forklift at the door: twelve times as large, without forks, in hills."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from seen import Seen

import fleetlog
from fleetlog.core.network import Edge, build_network
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Truck, load_truck
from fleetlog.discovery.channels.energy import EnergyChannel
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.physics.model import save_physics
from fleetlog.physics.power import Physics
from fleetlog.store import Dataset

SAMPLE = Path(__file__).parents[2] / "sample_data"
TRUCK = load_truck(SAMPLE / "truck.toml")
TIMES = 12.0
LARGE = ("chassis.mass", "chassis.rated_load", "auxiliary.power", "resistance.drag_area", "drive.max_power")


def driven(folder: Path, site: str, physics: dict[str, dict[str, float]], rate: float = 2.0) -> Dataset:
    folder.mkdir(exist_ok=True)
    save_physics(folder, Physics(TRUCK, physics))
    fleetlog.simulate(
        site=SAMPLE / site, truck=SAMPLE / "truck.toml", vehicles=3, duration="1h", seed=4, rate=rate,
        physics=folder / "model.toml", recording=False, output=folder / "day",
    )  # fmt: skip
    return Dataset(folder / "day")


def power(dataset: object, truck: Truck = TRUCK) -> Diagnosis:
    return diagnose(dataset, truck, channels=("battery_power",))  # type: ignore[arg-type]


def test_a_vehicle_twelve_times_as_large_is_diagnosed_alike(tmp_path: Path) -> None:
    """All forces and powers times twelve: the same physics is missing, twelve times as much of it."""
    day = driven(tmp_path, "site.toml", {"auxiliary_load": {"power": 800.0}})
    large = TRUCK
    for key in LARGE:
        large = large.with_value(key, TIMES * TRUCK.value(key))
    large = replace(large, lift=replace(large.lift, carriage_mass=TIMES * large.lift.carriage_mass))

    def larger(t: Trajectory) -> Trajectory:
        return t.with_columns(
            battery_power=TIMES * t.floats("battery_power"), payload=TIMES * t.floats("payload")
        )

    one, twelve = power(day), power(Seen(day, larger, day.site), large)
    assert [f.term for f in one.verdict.findings] == ["auxiliary_load"]
    assert [f.term for f in twelve.verdict.findings] == ["auxiliary_load"]
    values = [d.verdict.findings[0].parameters[0].value for d in (one, twelve)]
    assert values[1] == pytest.approx(TIMES * values[0], rel=0.02)
    assert values[0] == pytest.approx(800.0, rel=0.03)


def test_a_load_that_goes_out_as_soon_as_the_truck_stands_is_named(tmp_path: Path) -> None:
    found = power(driven(tmp_path, "site.toml", {"enabled_load": {"power": 400.0, "hold": 0.0}})).verdict
    assert [f.term for f in found.findings] == ["enabled_load"]
    value, hold = (p.value for p in found.findings[0].parameters[:2])
    assert value == pytest.approx(400.0, rel=0.1)
    assert hold < 2.2


def test_a_truck_that_brakes_by_friction_alone_is_named(tmp_path: Path) -> None:
    """Nothing comes back to the battery: by chance the estimate would be below that as often as above."""
    found = power(driven(tmp_path, "site.toml", {"regeneration": {"regeneration": 0.0}})).verdict
    assert (found.word, [f.term for f in found.findings]) == ("found", ["regeneration"])
    told = found.findings[0].parameters[0]
    assert told.low == 0.0 < told.value < told.high < 0.1


def test_heights_that_the_log_shows_leave_no_slope_to_find(tmp_path: Path) -> None:
    """Heights drift by 0.2 m, as those of a receiver; the map is flat. What is missing is drag."""
    day = driven(tmp_path, "site_3d.toml", {"viscous_drag": {"coefficient": 120.0}})
    assert np.ptp(day.read(day.vehicles[0]).floats("z")) > 0.5
    roads = day.site.roads()
    flat = replace(day.site, network=build_network(roads.edges(), has_elevation=False))
    rng = np.random.default_rng(2)

    def drifting(t: Trajectory) -> Trajectory:
        drift = np.convolve(rng.normal(size=len(t) + 59), np.ones(60), "valid") / np.sqrt(60.0)
        return t.with_columns(z=t.floats("z") + 0.2 * drift)

    found = power(Seen(day, drifting, flat)).verdict
    assert "grade" not in [f.term for f in found.findings]
    assert {f.term for f in found.findings} & {"viscous_drag", "rolling_resistance", "aerodynamic_drag"}


def switched_off(t: Trajectory) -> Trajectory:
    """A break of half an hour in which rows go on and the battery gives a few watts, as for a clock."""
    begin = int(np.flatnonzero((t.floats("speed") == 0.0) & (t.seconds() > t.seconds()[0] + 900.0))[0])
    count, step = 3600, 500_000
    rows = t[np.concatenate([np.arange(begin), np.full(count, begin), np.arange(begin, len(t))])]
    time = np.concatenate(
        [t.time[:begin], t.time[begin] + step * np.arange(count), t.time[begin:] + step * count]
    )
    power = rows.floats("battery_power").copy()
    power[begin + 1 : begin + count - 1] = 8.0
    return Trajectory(t.vehicle_id, time, {**rows.columns, "battery_power": power})


def in_whole_kmh(t: Trajectory) -> Trajectory:
    return t.with_columns(speed=np.round(3.6 * t.floats("speed")) / 3.6)


@pytest.mark.parametrize("change", [switched_off, in_whole_kmh, lambda t: t.without("payload")])
def test_what_plants_do_to_logs_is_no_physics(
    tmp_path: Path, change: Callable[[Trajectory], Trajectory]
) -> None:
    """Trucks whose key is off between rows that go on, speeds in whole km/h, lifts of loads that nobody wrote."""
    day = driven(tmp_path, "site.toml", {})
    found = diagnose(Seen(day, change, day.site), TRUCK).verdict  # type: ignore[arg-type]
    assert [f.term for f in found.findings if f.term != "congestion"] == []
    assert found.word != "unknown"


def test_rows_farther_apart_than_a_window_say_nothing_of_motion(tmp_path: Path) -> None:
    day = driven(tmp_path, "site.toml", {"auxiliary_load": {"power": 1500.0}})
    found = diagnose(Seen(day, lambda t: t[::30], day.site), TRUCK).verdict  # type: ignore[arg-type]
    told = {c.name: c.reason for c in found.channels}
    assert told["battery_power"] == told["speed"]
    assert "15 s apart" in (told["battery_power"] or "")
    assert not [f for f in found.findings if f.channel != "soc"]


@pytest.mark.parametrize("off, word", [(0.015, "none"), (0.05, "unknown"), (0.15, "found")])
def test_a_map_whose_heights_are_off(tmp_path: Path, off: float, word: str) -> None:
    """Heights of all junctions are off by chance [m]: no survey is better than a centimetre or two, five are
    not passed over in silence, and fifteen are slopes that the map lacks."""
    day = driven(tmp_path, "site_3d.toml", {})
    roads = day.site.roads()
    rng = np.random.default_rng(3)
    error = dict(zip(roads.node_ids, off * rng.normal(size=len(roads.node_ids)), strict=True))

    def wrong(edge: Edge) -> Edge:
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(edge.points, axis=0), axis=1))])
        points = edge.points.copy()
        points[:, 2] += error[edge.start] + (error[edge.end] - error[edge.start]) * way / way[-1]
        return replace(edge, points=points)

    site = replace(day.site, network=build_network([wrong(e) for e in roads.edges()]))
    found = power(Seen(day, lambda t: t, site)).verdict
    assert found.word == word
    assert [f.term for f in found.findings] == (["grade"] if word == "found" else [])


@pytest.mark.parametrize(
    "lifts, step, usable", [(0.0, 0.0, 1.0), (0.0, 2500.0, 1.0), (0.3, 0.0, 0.7), (0.3, 2500.0, 0.7)]
)
def test_standstills_count_where_nothing_lifts(lifts: float, step: float, usable: float) -> None:
    """Without fork heights: pulses over the usual power are lifts, a new usual power is none."""
    rng = np.random.default_rng(1)
    count = 400
    rate = 3800.0 + 40.0 * rng.normal(size=count) + step * (np.arange(count) > 220)
    rate += np.where(rng.random(count) < lifts, 3000.0, 0.0)
    chassis = SimpleNamespace(rated_load=2000.0)
    fleet = SimpleNamespace(truck=SimpleNamespace(chassis=chassis), has=lambda _: False)
    channel = SimpleNamespace(fleet=fleet, measured=False)
    cut = SimpleNamespace(
        count=count, motion=SimpleNamespace(speed=np.zeros(count)), energy=lambda watts: watts * 1e-2
    )
    seen = EnergyChannel._seen_lifts(channel, cut, np.full(count, 10.0), rate * 1e-2)  # type: ignore[arg-type]
    assert seen.mean() == pytest.approx(usable, abs=0.06)


def test_tolerances_that_are_used_up_all_one_way_are_said(tmp_path: Path) -> None:
    """An efficiency of 0.73 in place of 0.81 is imitated by five small errors: nothing is told but that."""
    day = driven(
        tmp_path, "site.toml", {"drivetrain_efficiency": {"efficiency": 0.9 * TRUCK.drive.efficiency}}
    )
    found = power(day).verdict
    said = [n for n in found.notes if "within its tolerance" in n]
    named = [f.parameters[0].value for f in found.findings if f.term == "drivetrain_efficiency"]
    assert said or named == [pytest.approx(0.9 * TRUCK.drive.efficiency, rel=0.02)]
    clean = power(driven(tmp_path / "clean", "site.toml", {})).verdict
    assert not [n for n in clean.notes if "within its tolerance" in n]
