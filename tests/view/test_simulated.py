"""Tasks, reservations, charging and activities of a simulation in its recording; its tables are the authority."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rrd
from fixtures_view import complaints
from ink import is_drawn, views

from fleetlog.core.network import reduced
from fleetlog.core.truck import load_truck
from fleetlog.roads import load_site
from fleetlog.simulate.engine import Settings, simulate
from fleetlog.simulate.tasks import Demand, Task
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.events import TABLES, read_table
from fleetlog.view import events, recording, viewer
from fleetlog.view.comparison import write_comparison

TRUCKS = 4


@pytest.fixture(scope="module")
def sim(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> SimpleNamespace:
    """Four trucks, of which some charge, with more tasks than they can do."""
    site, _ = load_site(project_root / "sample_data" / "site.toml")
    truck = load_truck(project_root / "sample_data" / "truck.toml")
    path = tmp_path_factory.mktemp("simulated") / "dataset"
    tasks = [Task(None, f"dock-{k % 3 + 1}", f"line-{k % 2 + 1}", 800.0, 10.0 * k) for k in range(8)]
    with DatasetWriter.create(path, "simulated", site) as writer:
        settings = Settings(vehicles=TRUCKS, duration=300.0, interval=1.0, seed=2, soc=0.3005)
        simulate(site, truck, writer, settings, Demand(tasks, endless=False))
    out = recording.write_recording(path, path / "recording.rrd")
    dataset = Dataset(path)
    return SimpleNamespace(
        path=path, out=out, vehicles=dataset.vehicles, **{name: read_table(dataset, name) for name in TABLES}
    )


def micros(column) -> np.ndarray:
    return column.dt.tz_localize(None).to_numpy("datetime64[us]").astype(np.int64)


@cache
def strips(path: Path, entity: str):
    return rrd.column(path, entity, "LineStrips3D:strips")


def strips_at(path: Path, entity: str, moment: int) -> list[np.ndarray]:
    """What an entity shows at a time: its latest row."""
    time, values = strips(path, entity)
    row = int(np.searchsorted(time, moment, side="right")) - 1
    return [] if row < 0 else [np.array(s) for s in values[row].as_py()]


def test_everything_has_its_entity_and_its_view(sim: SimpleNamespace) -> None:
    found = rrd.entities(sim.out)
    for vehicle in sim.vehicles:
        assert {f"/{kind}/{vehicle}" for kind in ("tasks", "reserved", "state")} <= found
    assert {"/charging", "/tasks/waiting", "/open/waiting", "/open/on\\ the\\ forks"} <= found
    assert {"Activities", "Site", "Plan", "Summary"} <= rrd.views(sim.out)
    assert any(name.startswith("Open tasks") for name in rrd.views(sim.out))


def test_states_are_the_activities(sim: SimpleNamespace) -> None:
    for vehicle in sim.vehicles:
        time, states = rrd.column(sim.out, f"/state/{vehicle}", "StateChange:state")
        mine = sim.activities[sim.activities.vehicle_id == vehicle].sort_values("start")
        drawn = np.array([s[0] for s in states.to_pylist()])
        at = np.searchsorted(time, micros(mine.start), side="right") - 1
        assert (drawn[at] == mine.activity.to_numpy()).all()
        assert set(time) <= set(micros(mine.start))


def test_reserved_ways_are_drawn_while_they_are_held(sim: SimpleNamespace) -> None:
    line = {w.way: np.column_stack([w.x, w.y]) for w in sim.ways.itertuples()}
    start, end = micros(sim.reservations.start), micros(sim.reservations.end)
    checked = 0
    for moment in np.unique(start):
        for vehicle in sim.vehicles:
            held = sim.reservations[
                (sim.reservations.vehicle_id == vehicle) & (start <= moment) & (moment < end)
            ].way
            drawn = strips_at(sim.out, f"/reserved/{vehicle}", int(moment))
            ends = sorted([s[0, :2].tolist(), s[-1, :2].tolist()] for s in drawn)
            truth = sorted([line[w][0].tolist(), line[w][-1].tolist()] for w in held)
            assert len(ends) == len(truth)
            np.testing.assert_allclose(ends, truth, atol=1e-3)
            checked += len(held)
    assert checked > 20


def test_an_arc_leads_from_source_to_target_while_a_task_is_open(sim: SimpleNamespace) -> None:
    spot = {place: rows[["x", "y"]].mean().to_numpy() for place, rows in sim.bays.groupby("place")}
    done = sim.tasks[sim.tasks.status == "done"]
    assert len(done) >= 2
    for task in done.itertuples():
        assigned, picked, dropped = (t.value // 1000 for t in (task.assigned, task.picked, task.dropped))
        fetched = strips_at(sim.out, f"/tasks/{task.vehicle_id}", assigned)
        brought = strips_at(sim.out, f"/tasks/{task.vehicle_id}", picked)
        assert len(fetched) > len(brought) == 2, "dashes, then one line and its head"
        for strips in (fetched, brought):
            np.testing.assert_allclose(strips[0][0, :2], spot[task.from_place], atol=1e-3)
            np.testing.assert_allclose(strips[-2][-1, :2], spot[task.to_place], atol=1e-3)
        later = sim.tasks[(sim.tasks.vehicle_id == task.vehicle_id) & (sim.tasks.assigned == task.dropped)]
        assert len(later) or not strips_at(sim.out, f"/tasks/{task.vehicle_id}", dropped)


def test_a_charging_truck_has_rings_about_it(sim: SimpleNamespace) -> None:
    visits = sim.activities[sim.activities.activity == "charge"]
    assert len(visits)
    spot = {place: rows[["x", "y"]].mean().to_numpy() for place, rows in sim.bays.groupby("place")}
    for visit in visits.itertuples():
        glow = strips_at(sim.out, "/charging", visit.start.value // 1000)
        centres = np.array([s[:-1, :2].mean(axis=0) for s in glow])
        assert (np.hypot(*(centres - spot[visit.place]).T) < 0.01).sum() == 3
    assert not strips_at(sim.out, "/charging", visits.start.min().value // 1000 - 1)


def test_large_fleets_have_curves_and_one_entity_of_reservations(
    sim: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "MANY", TRUCKS)
    out = recording.write_recording(sim.path, tmp_path / "many.rrd")
    found = rrd.entities(out)
    assert "/reserved/fleet" in found and not any(e.startswith(("/tasks", "/state")) for e in found)
    assert {"Trucks by activity", "Open tasks"} <= rrd.views(out)
    curves = [rrd.scalars(out, e) for e in found if e.startswith("/activity/")]
    every = np.unique(np.concatenate([t for t, _ in curves]))
    total = sum(n[np.searchsorted(t, every, side="right") - 1] for t, n in curves)
    np.testing.assert_allclose(total, TRUCKS, rtol=1e-9)
    # Time by activity, from the curves and from the table.
    drawn = {e.split("/")[-1]: rrd.scalars(out, e) for e in found if e.startswith("/activity/")}
    spent = (
        (sim.activities.end - sim.activities.start).dt.total_seconds().groupby(sim.activities.activity).sum()
    )
    start = int(micros(sim.activities.start).min())
    bins = np.linspace(start, start + 300_000_000, events.CURVE_POINTS + 1).astype(np.int64)[:-1]
    for name, seconds in spent.items():
        time, mean = drawn[name]
        assert mean[np.searchsorted(time, bins, side="right") - 1].mean() * 300.0 == pytest.approx(seconds)


def test_side_by_side_with_another_fleet(sim: SimpleNamespace, tmp_path: Path) -> None:
    out = write_comparison(sim.path, sim.path, tmp_path / "both.rrd")
    found = rrd.entities(out)
    vehicle = sim.vehicles[0]
    for fleet in ("recorded", "simulated"):
        assert {f"/{fleet}/{kind}/{vehicle}" for kind in ("tasks", "reserved", "state")} <= found


@pytest.mark.skipif(viewer.vulkan_missing() is not None, reason="the viewer cannot draw here")
def test_a_simulation_is_drawn(sim: SimpleNamespace) -> None:
    with viewer.open_headless(sim.out, (1200, 800)) as client:
        start, _ = viewer.span(client)
        viewer.pause_at(client, start + 150_000_000_000)
        assert [v for v in views(client) if v.startswith("Open tasks")]
        for name in views(client):
            if name.startswith(("Activities", "Open tasks", "Plan")):
                assert is_drawn(client, name), name
        assert not complaints(client)


def test_a_line_is_reduced_to_what_its_tolerance_needs() -> None:
    turn = np.linspace(0.0, np.pi / 2, 200)
    bend = np.column_stack([10 * np.cos(turn), 10 * np.sin(turn), np.zeros(200)])
    for tolerance in (0.5, 0.1, 0.02):
        kept = reduced(bend, tolerance)
        # The chord of an arc of radius r is r (1 - cos(half its angle)) away from it.
        angles = np.arctan2(kept[:, 1], kept[:, 0])
        assert (10 * (1 - np.cos(np.diff(angles) / 2))).max() <= tolerance + 1e-9
        assert (kept[[0, -1]] == bend[[0, -1]]).all()
    straight = np.column_stack([np.linspace(0, 30, 61), np.zeros(61), np.zeros(61)])
    assert len(reduced(straight, 0.01)) == 2


def test_spots_drawn_along_the_roads_are_shown(sim: SimpleNamespace) -> None:
    known = {p.id for p in Dataset(sim.path).site.places}
    drawn = sim.bays[~sim.bays.place.isin(known)]
    found = {e for e in rrd.entities(sim.out) if e.endswith("/drawn/points")}
    assert found == {f"/site/places/{kind}/drawn/points" for kind in drawn.kind.unique()}


def test_a_day_of_a_simulation_shows_nothing_of_the_other(
    tmp_path: Path, project_root: Path, sim: SimpleNamespace
) -> None:
    """A run from two minutes before midnight to three after it."""
    site, _ = load_site(project_root / "sample_data" / "site.toml")
    truck = load_truck(project_root / "sample_data" / "truck.toml")
    path, midnight = tmp_path / "dataset", 1_772_496_000_000_000
    with DatasetWriter.create(path, "simulated", site) as writer:
        settings = Settings(vehicles=2, duration=300.0, interval=1.0, seed=2, start=midnight - 120_000_000)
        simulate(site, truck, writer, settings)
    for day, after in (("2026-03-02", False), ("2026-03-03", True)):
        out = recording.write_recording(path, tmp_path / "day.rrd", day=day)
        times = np.concatenate([rrd.times(out, entity) for entity in rrd.entities(out)])
        # A curve that ends is followed by nothing a microsecond later, a truck by a gap of ten seconds.
        assert (times >= midnight).all() if after else (times < midnight + 11_000_000).all()
        assert np.ptp(times) > 100_000_000
