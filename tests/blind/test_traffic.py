"""Recordings of traffic: trucks wait for one another, and the key tells what that costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from cases import Case
from run import run
from streets import IMPERFECT, mission
from traffic import Streets, motion_of, record, streets_world

pytest.importorskip("sumo", reason="the wheel eclipse-sumo is not installed")
FLEET = "site=grid,seed=3,hours=0.2"


def test_a_truck_alone_loses_nothing_and_many_lose_time(tmp_path: Path) -> None:
    one = record(f"none,{FLEET},vehicles=1", tmp_path / "one")
    many = record(f"none,{FLEET},vehicles=12", tmp_path / "many")
    assert abs(one["congestion"]["share"]) < 1e-9
    assert 0.003 < many["congestion"]["share"] < 0.2


def test_a_recording_of_traffic_is_its_case_to_the_byte(tmp_path: Path) -> None:
    keys = [record(f"waiting,{FLEET},vehicles=2", tmp_path / folder) for folder in "ab"]
    assert keys[0] == keys[1]
    logs = [(tmp_path / folder / "recorded.csv.gz").read_bytes() for folder in "ab"]
    assert logs[0] == logs[1]


def test_laden_trucks_are_as_much_slower_as_the_key_says(tmp_path: Path) -> None:
    key = record(f"laden_speed,{FLEET},vehicles=2", tmp_path)
    log = pl.read_csv(tmp_path / "recorded.csv.gz")
    fast = [log.filter((pl.col("payload") > 0) == laden)["speed"].quantile(0.9) for laden in (False, True)]
    assert fast[1] / fast[0] == pytest.approx(key["effects"][0]["parameters"]["factor"], rel=0.1)


def test_distance_by_speed_is_that_by_positions(tmp_path: Path) -> None:
    record(f"none,{FLEET},vehicles=2", tmp_path)
    log = pl.read_csv(tmp_path / "recorded.csv.gz").filter(pl.col("vehicle_id") == "T1")
    north, east = np.diff(log["latitude"]) * 111_229.0, np.diff(log["longitude"]) * 71_740.0
    moving = log["speed"].to_numpy()[1:] > 1.0
    assert np.hypot(north, east)[moving].sum() == pytest.approx(
        log["speed"].to_numpy()[1:][moving].sum(), rel=0.03
    )


def test_turns_are_taken_with_the_lateral_acceleration_of_the_truck_file(tmp_path: Path) -> None:
    w = streets_world(Case.parse(f"none,{FLEET},vehicles=1"))
    way = mission(w.site, w.truck, 0.2, np.random.default_rng(1))
    track = Streets(w, [way], tmp_path).drive([0], [], IMPERFECT, 0.2)[0]
    m = motion_of(w, track, way, 0, np.random.default_rng(1))
    sideways = m.v**2 * np.abs(m.bend)
    begins = np.flatnonzero(np.diff(np.abs(m.bend) > 0.1))
    pieces = np.split(np.arange(len(m)), begins + 1)
    turned = [abs(np.ptp(m.heading[k])) if m.v[k].min() > 1.0 else 0.0 for k in pieces]
    turns = [
        sideways[k].max()
        for k, angle in zip(pieces, turned, strict=True)
        if angle > 0.8 and abs(m.bend[k]).min() > 0.1
    ]
    assert len(turns) > 5
    assert np.median(turns) == pytest.approx(w.truck.lateral, rel=0.15)


@pytest.mark.slow
def test_a_wait_behind_which_others_queue_is_a_wait_and_their_queue_congestion(tmp_path: Path) -> None:
    done = run(Case.parse("waiting,site=grid,seed=4003,hours=0.6,vehicles=14"), tmp_path)
    (effect,), share = done["key"]["effects"], done["key"]["congestion"]["share"]
    found = {f["term"]: f for f in done["found"]["findings"]}
    assert set(found) == {"waiting", "congestion"}
    assert {e["edge_id"].removeprefix("-") for e in found["waiting"]["where"]["edges"]} == set(
        effect["roads"]
    )
    wait, lost = (found[term]["parameters"][0] for term in ("waiting", "congestion"))
    assert wait["low"] <= effect["parameters"]["seconds"] <= wait["high"]
    assert lost["value"] == pytest.approx(share, rel=0.25)
