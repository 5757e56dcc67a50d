"""Effects written into a clean recording of another generator are found as they were written."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from conceal import diagnosed
from degrade import diagnosed_as
from recorder import record

from fleetlog import diagnose, read_logs
from fleetlog.core.truck import load_truck

pytestmark = pytest.mark.slow


def found(shared_data: Path, effect: str) -> list[dict[str, Any]]:
    return diagnosed(shared_data / "engine" / "clean", effect)["findings"]


def test_a_load_that_grows_is_a_drift(shared_data: Path) -> None:
    """A curve over the time of day says as much, and no more."""
    (only,) = found(shared_data, "load that grows")
    assert only["term"] == "auxiliary_load" and only["scope"]["drift"]
    added = next(p for p in only["parameters"] if p["name"] == "added_power")
    assert added["low"] <= 600.0 <= added["high"]


def test_a_rough_floor_is_told_on_all_of_its_roads(shared_data: Path) -> None:
    """Each piece of a road is hardly told from the next, all of them stand out."""
    (only,) = found(shared_data, "rough floor")
    assert only["term"] == "surface_resistance"
    edges = only["where"]["edges"]
    assert len(edges) >= 6 and sum(e["to"] - e["from"] for e in edges) > 200.0
    low_x, low_y, high_x, _ = only["where"]["extent"]
    assert high_x - low_x > 200.0 and low_y > 60.0


@pytest.mark.parametrize(("recording", "effect", "newtons"), [
    ("engine/clean", "drag", 500.0), ("blind/none", "drag of one truck", 400.0),
])  # fmt: skip
def test_a_brake_that_rubs_is_no_rolling_resistance(
    recording: str, effect: str, newtons: float, shared_data: Path
) -> None:
    """Its force is the same with and without a load. No word of the vocabulary says so; sentence and number do."""
    (only,) = diagnosed(shared_data / recording, effect)["findings"]
    of_one = effect.endswith("one truck")
    assert only["term"] == "unknown" and "a rubbing brake" in only["statement"]
    assert only["depends_on"] == ["vehicle_id" if of_one else "driving"]
    assert bool(only["scope"]["vehicles"]) == of_one
    (force,) = only["parameters"]
    assert force["low"] <= newtons <= force["high"]


def test_an_efficiency_that_tolerances_imitate_is_noted(shared_data: Path) -> None:
    """Mass, load, rolling resistance and others, each within its tolerance, say what 15 % less efficiency does."""
    said = diagnosed(shared_data / "blind" / "none", "efficiency")
    assert not said["findings"]
    assert any("drivetrain_efficiency may be wrong" in note for note in said["notes"])
    assert not any(
        "may be wrong" in note for note in diagnosed(shared_data / "blind" / "none", "nothing")["notes"]
    )


def test_a_floor_that_is_rough_since_is_told_to_the_second_and_explains_all(shared_data: Path) -> None:
    """Slots of the time are 225 s long; windows say where within them it began. Nothing else is told."""
    said = diagnosed(shared_data / "blind" / "none", "rough floor since")
    (only,) = said["findings"]
    assert only["term"] == "surface_resistance" and only["scope"]["until"] is None
    assert "T06:29:30" < only["scope"]["from"][10:] < "T06:30:40"
    (power,) = (c for c in said["channels"] if c["name"] == "battery_power")
    assert power["before"] > 0.2 and power["after"] <= 1.2 * power["floor"]


def test_a_site_that_tilts_has_a_grade(shared_data: Path) -> None:
    """A curve over the heading says as much, with eight numbers for two."""
    (only,) = found(shared_data, "tilted site")
    assert only["term"] == "grade"


def test_a_load_of_one_truck_since_is_told_where_few_folds_have_its_hours(shared_data: Path) -> None:
    """Three folds of ten hold that truck after that time, one of them most of it: each alone is evident."""
    told = diagnosed(shared_data / "traffic" / "none_dense", "load of one truck since")["findings"]
    (load,) = (f for f in told if f["term"] != "congestion")
    assert load["term"] == "auxiliary_load" and load["scope"]["vehicles"] == ["F01"]
    begin = datetime.fromisoformat(load["scope"]["from"])
    assert abs(begin - datetime(2026, 3, 2, 5, 45, tzinfo=UTC)) < timedelta(seconds=30)
    assert load["scope"]["until"] is None
    added = next(p for p in load["parameters"] if p["name"] == "added_power")
    assert added["low"] <= 600.0 <= added["high"]


def test_what_follows_the_temperature_is_not_outlined_by_numbers_of_hours(shared_data: Path) -> None:
    """Rolling resistance until one hour, an efficiency until the next and a mass say it less well than one curve."""
    (only,) = diagnosed(shared_data / "blind" / "none", "stiff when cold")["findings"]
    assert only["term"] == "unknown" and "ambient_temperature" in only["depends_on"]


def test_a_load_that_comes_and_goes_is_not_all_explained(shared_data: Path) -> None:
    """Its mean is an auxiliary load of 200 W; five minutes of fifteen it is 600 W, which no column shows."""
    said = diagnosed(shared_data / "engine" / "clean", "load that comes and goes")
    assert said["verdict"] == "unknown"
    load, lasts = sorted(said["findings"], key=lambda f: f["term"])
    assert load["term"] == "auxiliary_load" and lasts["term"] == "unknown" and lasts["depends_on"] == ["time"]
    added = next(p for p in load["parameters"] if p["name"] == "added_power")
    assert added["low"] <= 200.0 <= added["high"]
    assert lasts["statement"].startswith("A consumer that no column shows goes on and off")


def test_power_that_follows_the_load_at_rest_and_in_motion_is_told_by_it(shared_data: Path) -> None:
    told = diagnosed(shared_data / "traffic" / "none_dense", "pump with a load")["findings"]
    (pump,) = (f for f in told if f["term"] != "congestion")
    assert pump["term"] == "unknown" and pump["depends_on"] == ["payload"]


def test_a_truck_that_is_driven_slowly_since_noon_is_told_as_that(shared_data: Path) -> None:
    """All it does takes 1.3 times as long: it drives at 0.93 / 1.3 of what is permitted, and nothing of it is a
    number of corners or loads."""

    def slowed(out: Path) -> None:
        log = pl.read_csv(shared_data / "blind" / "none" / "recorded.csv.gz", infer_schema_length=20_000)
        time = pl.col("timestamp").str.to_datetime(time_zone="UTC").dt.epoch("us")
        log = log.drop("battery_power", "soc").with_columns(time=time)
        slow = (pl.col("vehicle_id") == "F01") & (pl.col("speed") > 0.05)
        late = pl.col("time") > (pl.col("time").min() + pl.col("time").max()) / 2
        factor = pl.when(slow & late).then(1.3).otherwise(1.0)
        step = (pl.col("time").diff().fill_null(0) * factor).cum_sum().over("vehicle_id")
        log = log.with_columns(
            speed=pl.col("speed") / factor,
            timestamp=(pl.col("time").first().over("vehicle_id") + step).cast(pl.Datetime("us")),
        )
        log.drop("time").write_csv(out, datetime_format="%Y-%m-%dT%H:%M:%S%.6fZ")

    said = diagnosed_as(shared_data / "blind" / "none", slowed)["findings"]
    assert all(
        f["scope"]["vehicles"] == ["F01"] and "T06:2" < f["scope"]["from"][10:] < "T06:32" for f in said
    )
    assert not {f["term"] for f in said} & {"laden_speed", "cornering_speed", "speed_zone"}
    first = said[0]
    (share,) = first["parameters"]
    assert first["term"] == "unknown" and "permitted speed" in first["statement"]
    assert np.isclose(share["value"], 0.93 / 1.3, atol=0.05)


@pytest.mark.parametrize("column", ["positions", "speed"])
def test_positions_and_speed_a_second_apart_are_put_right(column: str, shared_data: Path) -> None:
    """Late positions are a second behind the power, too; a late speed leaves the rest as it was."""

    def late(out: Path) -> None:
        log = pl.read_csv(shared_data / "blind" / "none" / "recorded.csv.gz", infer_schema_length=20_000)
        names = ["latitude", "longitude"] if column == "positions" else ["speed"]
        log.with_columns(pl.col(names).shift(1).backward_fill().over("vehicle_id")).write_csv(out)

    said = diagnosed_as(shared_data / "blind" / "none", late)
    way = "ahead of" if column == "positions" else "behind"
    (note,) = (n for n in said["notes"] if "speed channel" in n)
    assert f"1.0 s {way} the positions" in note and note.endswith("F01, F02, F03, F04")
    assert [f["term"] for f in said["findings"]] == ["clock_offset"] * (column == "positions")
    for clock in said["findings"]:
        assert -1.1 < clock["parameters"][0]["value"] < -0.7
    assert all(c["after"] < 0.06 for c in said["channels"])


@pytest.mark.parametrize(
    ("folder", "heavy"), [("engine/clean", ["M1", "M3"]), ("blind/none", ["F01", "F03"])]
)
def test_trucks_that_are_heavier_than_the_others_are_told_together(
    folder: str, heavy: list[str], shared_data: Path
) -> None:
    """What a truck weighs more its tolerances say nearly as well: each of them on its edge, and so of the next."""
    (only,) = diagnosed(shared_data / folder, "mass of half the trucks")["findings"]
    assert only["term"] == "mass" and only["scope"]["vehicles"] == heavy
    (mass,) = only["parameters"]
    nominal = load_truck(shared_data / folder / "truck.toml").chassis.mass
    assert mass["low"] <= 1.2 * nominal <= mass["high"]


def told(folder: Path, *columns: pl.Expr) -> dict[str, Any]:
    """The diagnosis of a clean recording with other columns."""
    table = pl.read_csv(folder / "recorded.csv.gz", infer_schema_length=20_000)
    return diagnosed_as(folder, table.with_columns(*columns).write_csv)


def test_a_small_battery_of_one_truck_is_told_through_coarse_steps(shared_data: Path) -> None:
    """Its charge falls by a quarter more: a resistance would take less of it where less power is drawn."""
    soc, first = pl.col("soc"), pl.col("soc").first().over("vehicle_id")
    own = pl.col("vehicle_id") == pl.col("vehicle_id").min()
    fallen = pl.when(own).then(first + (soc - first) / 0.8).otherwise(soc)
    found = told(shared_data / "blind" / "none", fallen.round(3).alias("soc"))["findings"]
    (only,) = found
    assert only["term"] == "battery_capacity" and len(only["scope"]["vehicles"]) == 1
    truck = load_truck(str(shared_data / "blind" / "none" / "truck.toml"))
    (number,) = only["parameters"]
    assert number["low"] <= 0.8 * truck.battery.capacity_wh <= number["high"]


@pytest.mark.parametrize("rows", [2, 5])
def test_a_power_that_is_repeated_is_nothing_missing(shared_data: Path, rows: int) -> None:
    """Values of a slow bus beside fast positions are of their first row, and no mean of the last seconds."""
    first = pl.int_range(pl.len()) // rows * rows
    power = pl.col("battery_power").gather(first).over("vehicle_id")
    said = told(shared_data / "engine" / "clean", power)
    assert said["findings"] == [] and said["verdict"] == "none"
    assert any("repeated in between" in note for note in said["notes"])


def test_trucks_whose_loads_nobody_recorded_are_no_heavier(tmp_path: Path) -> None:
    """What they carry on average acts like mass, in a log without loads and forks."""
    record("none,site=ramps,logger=no_load,seed=4000", tmp_path)
    read_logs(tmp_path / "recorded.csv.gz", site=tmp_path / "site.toml", output=tmp_path / "data")
    told = diagnose(tmp_path / "data", truck=tmp_path / "truck.toml", channels=("battery_power",)).summary
    assert told["findings"] == []
