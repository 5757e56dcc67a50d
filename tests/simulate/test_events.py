"""Laws of the tables of tasks, activities and reservations; the rows of the trajectories are the outside authority."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from simulated_sites import TRUCK, aisle, grid, place

from fleetlog.simulate import engine
from fleetlog.simulate.engine import DEFAULT_START, Settings, simulate
from fleetlog.simulate.occupancy import Policy
from fleetlog.simulate.state import Mode
from fleetlog.simulate.tasks import LEFT_OUT, Demand, Task, TaskBook
from fleetlog.simulate.world import build_world
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.events import ACTIVITIES, TABLES, WAYS, read_table

SECOND = pd.Timedelta(seconds=1)
PLACES = [
    place(0, "pick", 15, 3), place(1, "pick", 45, 3), place(0, "drop", 15, 57), place(1, "drop", 45, 57),
    place(0, "charge", 3, 15), place(1, "charge", 57, 45),
]  # fmt: skip
CASES = {
    "charging": (lambda: grid(places=PLACES), 8, {"soc": 0.302, "policy": Policy(0.3, 0.3, 0.31)}),
    "aisle": (aisle, 8, {"seed": 7}),
    "one-way": (lambda: grid(4, 4, seed=3), 16, {}),
}
FILES = [f"{name}.parquet" for name in TABLES]


def run(folder, site, trucks, seconds=600.0, seed=5, demand=None, **settings):
    with DatasetWriter.create(folder, "simulated", site) as writer:
        chosen = Settings(vehicles=trucks, duration=seconds, seed=seed, **settings)
        summary = simulate(site, TRUCK, writer, chosen, demand)
    dataset = Dataset(folder)
    return SimpleNamespace(
        folder=folder, site=site, trucks=trucks, seconds=seconds, summary=summary, dataset=dataset,
        tracks={v: dataset.read(v) for v in dataset.vehicles}, **{name: read_table(dataset, name) for name in TABLES},
    )  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def sim(request, tmp_path_factory):
    make, trucks, settings = CASES[request.param]
    return run(tmp_path_factory.mktemp("events") / "sim", make(), trucks, **settings)


@pytest.fixture(scope="module")
def charging(tmp_path_factory):
    make, trucks, settings = CASES["charging"]
    return run(tmp_path_factory.mktemp("charging") / "sim", make(), trucks, **settings)


def rows_within(sim, vehicle, start, end):
    """Rows of a truck inside a stretch, a second away from its ends: the tables know whole seconds."""
    track = sim.tracks[vehicle]
    low, high = (t.value // 1000 for t in (start + SECOND, end - SECOND))
    return track[(track.time >= low) & (track.time <= high)]


def test_activities_of_every_truck_cover_its_time_without_overlap(sim):
    begin = pd.Timestamp(DEFAULT_START, unit="us", tz="UTC")
    assert set(sim.activities.vehicle_id) == set(sim.dataset.vehicles)
    assert set(sim.activities.activity) <= set(ACTIVITIES)
    for _, rows in sim.activities.groupby("vehicle_id"):
        rows = rows.sort_values("start")
        assert rows.start.iloc[0] == begin
        assert rows.end.iloc[-1] == begin + pd.Timedelta(seconds=sim.summary.duration_s)
        assert (rows.start.iloc[1:].array == rows.end.iloc[:-1].array).all()
        assert (rows.end > rows.start).all()
        same = rows[["activity", "place", "task"]].fillna(-1).astype(str).agg("|".join, axis=1)
        assert (same.iloc[1:].array != same.iloc[:-1].array).all()


def test_activities_agree_with_the_rows(sim):
    stands = {"pick", "drop", "charge", "park", "wait_place", "wait_charger", "battery_empty"}
    seen = 0
    for a in sim.activities.itertuples():
        rows = rows_within(sim, a.vehicle_id, a.start, a.end)
        if not len(rows):
            continue
        seen += 1
        if a.activity in stands:
            assert (rows.floats("speed") == 0.0).all()
        if a.activity.startswith("drive"):
            assert ((rows.floats("payload") > 0.0) == (a.activity == "drive_laden")).all()
    assert seen > 20
    slow = sim.activities[sim.activities.activity == "wait"]
    waited = (slow.end - slow.start).dt.total_seconds().sum()
    # Each wait is cut to whole seconds at both ends.
    waiting = sim.summary.limits.waiting_s
    assert abs(waited - waiting["traffic"]) <= 2.0 * len(sim.activities)
    assert waited == pytest.approx(waiting["traffic"], rel=0.25)
    times = (
        (sim.activities.end - sim.activities.start).dt.total_seconds().groupby(sim.activities.activity).sum()
    )
    assert times.get("wait_place", 0.0) == pytest.approx(
        waiting["pick places"] + waiting["drop places"], abs=2.0
    )
    assert times.get("wait_charger", 0.0) == pytest.approx(waiting["chargers"], abs=2.0)


def test_every_task_is_a_row_and_comes_to_its_end_in_order(sim):
    t, count = sim.tasks, sim.summary.count
    assert t.task.tolist() == list(range(len(t)))
    assert len(t) == count.tasks_given > 5
    assert (t.status == "done").sum() == count.tasks_done > 3
    assert (t.status == "done").equals(t.dropped.notna())
    assert t.picked.notna().equals(t.status.isin(["loaded", "done"]))
    assert t.assigned.notna().equals(t.status != "waiting")
    assert t.vehicle_id.notna().equals(t.status != "waiting")
    assert (t.earliest.diff().dropna() >= pd.Timedelta(0)).all()
    known = t.dropna(subset=["assigned"])
    assert (known.earliest <= known.assigned).all()
    assert (t.dropna(subset=["picked"]).pipe(lambda p: p.assigned < p.picked)).all()
    assert (t.dropna(subset=["dropped"]).pipe(lambda p: p.picked < p.dropped)).all()


def test_a_truck_carries_the_load_of_its_task_and_no_other(sim):
    end = pd.Timestamp(sim.dataset.meta["end"])
    for task in sim.tasks[sim.tasks.picked.notna()].itertuples():
        done = task.status == "done"
        working = sim.activities[(sim.activities.task == task.task)].sort_values("start")
        assert set(working.vehicle_id) == {task.vehicle_id}
        assert working.start.min() == task.assigned
        drop = working[working.activity == "drop"]
        assert not done or (len(drop) == 1 and drop.place.item() == task.to_place)
        assert working[working.activity == "pick"].place.item() == task.from_place
        until = drop.start.min() if len(drop) else end
        rows = rows_within(sim, task.vehicle_id, task.picked, until)
        assert (rows.floats("payload") == pytest.approx(task.payload, abs=0.06)) or not len(rows)


def test_trucks_charge_at_chargers_and_their_charge_rises(charging):
    kind = {p.id: p.kind for p in charging.site.places}
    visits = charging.activities[charging.activities.activity == "charge"]
    assert len(visits) == charging.summary.count.charges >= 2
    assert {kind[p] for p in visits.place} == {"charge"}
    for a in visits.itertuples():
        rows = rows_within(charging, a.vehicle_id, a.start, a.end)
        assert len(rows) < 2 or (np.diff(rows.floats("soc")) > 0.0).all()
        assert (rows.floats("battery_power") < 0.0).all()
    # A charger takes one truck at a time.
    for _, rows in visits.groupby("place"):
        rows = rows.sort_values("start")
        assert (rows.start.iloc[1:].array >= rows.end.iloc[:-1].array).all()
    assert (charging.activities.activity == "wait_charger").any()


def test_trucks_stand_in_the_bays_of_their_places(sim):
    spots = {place: rows[["x", "y"]].to_numpy() for place, rows in sim.bays.groupby("place")}
    assert {p.id for p in sim.site.places} <= set(spots)
    for a in sim.activities[sim.activities.activity.isin(["pick", "drop", "charge", "park"])].itertuples():
        rows = rows_within(sim, a.vehicle_id, a.start, a.end)
        if len(rows):
            gap = np.hypot(*(spots[a.place] - [rows.floats("x")[0], rows.floats("y")[0]]).T)
            assert gap.min() < 0.05
    assert (sim.bays.heading.abs() <= np.pi).all()


def at_the_same_time(reservations):
    """Pairs of rows of different trucks that share a moment."""
    r = reservations.sort_values("start", kind="stable").reset_index(drop=True)
    start, end = r.start.astype("int64").to_numpy(), r.end.astype("int64").to_numpy()
    last = np.searchsorted(start, end, side="left")
    i = np.repeat(np.arange(len(r)), np.maximum(last - np.arange(len(r)) - 1, 0))
    j = np.concatenate([np.arange(k + 1, last[k]) for k in range(len(r))])
    vehicle, way = r.vehicle_id.to_numpy(), r.way.to_numpy()
    keep = vehicle[i] != vehicle[j]
    return np.unique(np.column_stack([way[i][keep], way[j][keep]]), axis=0)


def test_ways_that_exclude_each_other_are_never_reserved_by_two_trucks(sim):
    assert len(sim.reservations) > 50
    assert (sim.reservations.end > sim.reservations.start).all()
    assert set(sim.reservations.way) == set(sim.ways.way)
    assert sim.ways.way.is_unique and set(sim.ways.kind) <= set(WAYS)
    roads = build_world(sim.site, TRUCK, sim.trucks).roads
    for a, b in at_the_same_time(sim.reservations):
        assert b not in roads.conflicts[roads.conflict_first[a] : roads.conflict_first[a + 1]]


def crosses(p, q):
    """Whether two polylines (n, 2), (m, 2) cross each other at more than 30 degrees."""
    a, b = p[:-1, None], np.diff(p, axis=0)[:, None]
    c, d = q[None, :-1], np.diff(q, axis=0)[None]
    turn = lambda u, v: u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    span = turn(b, d)
    steep = np.abs(span) > 0.5 * np.linalg.norm(b, axis=-1) * np.linalg.norm(d, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = turn(c - a, d) / span, turn(c - a, b) / span
    return bool((steep & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)).any())


def test_what_two_trucks_have_reserved_never_crosses(sim):
    line = {w.way: np.column_stack([w.x, w.y]) for w in sim.ways.itertuples()}
    crossing = {(a, b) for a in line for b in line if a < b and crosses(line[a], line[b])}
    assert crossing
    assert not crossing & {(min(a, b), max(a, b)) for a, b in at_the_same_time(sim.reservations).tolist()}


def test_who_drives_over_a_turn_has_reserved_it(sim):
    """In the middle of a turn the road of a row changes: the two roads say which turn it was."""
    turns = sim.ways[sim.ways.kind == "turn"]
    number = {(w.edge_id, w.to_edge): w.way for w in turns.itertuples()}
    held = dict(list(sim.reservations.groupby(["vehicle_id", "way"])))
    passed = 0
    for vehicle, track in sim.tracks.items():
        edges = track.labels("edge_id").strings()
        for k in range(len(edges) - 1):
            way = number.get((edges[k], edges[k + 1]))
            if way is not None:
                before, after = (pd.Timestamp(track.time[i], unit="us", tz="UTC") for i in (k, k + 1))
                rows = held[vehicle, way]
                passed += 1
                assert ((rows.start <= after) & (rows.end >= before)).any()
    assert passed > 10


def test_same_seed_same_bytes_and_another_seed_others(tmp_path):
    make, trucks, settings = CASES["charging"]
    a, b, c = (
        run(tmp_path / n, make(), trucks, 200.0, s, **settings) for n, s in (("a", 1), ("b", 1), ("c", 2))
    )
    for name in FILES:
        assert (a.folder / name).read_bytes() == (b.folder / name).read_bytes()
    assert (a.folder / "tasks.parquet").read_bytes() != (c.folder / "tasks.parquet").read_bytes()


def test_looking_changes_nothing(tmp_path, monkeypatch):
    """Trajectories are byte by byte those of a run that nobody looks at."""
    make, trucks, settings = CASES["charging"]
    seen = run(tmp_path / "seen", make(), trucks, 200.0, **settings)
    monkeypatch.setattr(
        engine, "EventLog", lambda *_: SimpleNamespace(tick=lambda _: None, close=lambda _: None)
    )
    with DatasetWriter.create(tmp_path / "unseen", "simulated", make()) as writer:
        simulate(make(), TRUCK, writer, Settings(vehicles=trucks, duration=200.0, seed=5, **settings))
    files = sorted(p.relative_to(seen.folder) for p in seen.folder.glob("t*/**/*.parquet"))
    assert len(files) >= trucks
    for name in files:
        assert (seen.folder / name).read_bytes() == (tmp_path / "unseen" / name).read_bytes()
    assert "tables" not in Dataset(tmp_path / "unseen").meta
    assert read_table(Dataset(tmp_path / "unseen"), "tasks") is None


def test_given_tasks_that_were_not_done_are_reported(tmp_path):
    """Equal tasks are told apart, and none is lost: done, in work, waiting, of a later time, or impossible."""
    twice = [Task(None, "pick0", "drop0", 500.0, 0.0)] * 6
    tasks = [*twice, Task("T2", "pick1", "drop1", 700.0, 5.0), Task(None, "pick1", "drop0", 300.0, 1e6)]
    sim = run(tmp_path / "sim", grid(places=PLACES), 2, 300.0, demand=Demand(tasks, endless=False))
    count = sim.tasks.status.value_counts()
    assert len(sim.tasks) == len(tasks)
    assert count["later"] == 1
    assert count.sum() - count["later"] == sim.summary.count.tasks_given == 7
    assert count["done"] == sim.summary.count.tasks_done >= 2
    assert sim.tasks.vehicle_id[sim.tasks.payload == 700.0].item() == "T2"
    done = sim.tasks[sim.tasks.status == "done"]
    assert not done.duplicated(["vehicle_id", "dropped"]).any()


def test_a_task_that_is_given_back_keeps_its_number():
    book = TaskBook(["a", "b"])
    same = Task(None, "pick0", "drop0", 500.0, 3.0)
    for _ in range(2):
        book.give(same)
    book.assign(0, same, 4.0)
    book.give_back(0, same)
    book.assign(1, same, 9.0)
    book.assign(0, same, 10.0)
    book.note(1, status="loaded", picked=20.0)
    book.note(1, status="done", dropped=30.0)
    book.give(Task(None, "gone", "drop0", 1.0, 0.0), LEFT_OUT)
    columns = book.columns(0)
    assert columns["vehicle_id"].strings() == ["b", "a", None]
    assert columns["status"].strings() == ["done", "assigned", "left out"]
    assert columns["assigned"].tolist() == [9_000_000, 10_000_000, -1]
    assert columns["dropped"].tolist() == [30_000_000, -1, -1]
    assert columns["earliest"].tolist() == [3_000_000, 3_000_000, 0]


def test_what_counts_as_reserved_is_what_trucks_hold(tmp_path):
    """Narrow two-way roads and many trucks: they look for other doors while they still hold what is behind them."""
    site = grid(4, 4, 34.0, seed=2, width=2.2)
    with DatasetWriter.create(tmp_path / "sim", "simulated", site) as writer:
        settings = Settings(vehicles=45, duration=800.0, seed=1, interval=1.0)
        world = build_world(site, TRUCK, 45)
        run_ = engine.Run(world, settings, Demand(), writer)
        f, pieces, lanes = run_.fleet, len(world.roads.length), len(world.roads.clear)
        for step0 in range(0, 8000, run_.steps):
            run_.batch(step0)
            held = np.zeros(len(f.held), int)
            for v in range(45):
                for k in range(f.held_from[v], f.held_to[v] + 1):
                    piece = f.route[v, k]
                    end = k == f.held_to[v], k == f.held_from[v]
                    if piece < lanes and world.roads.capacity[piece] > 0 and any(end):
                        piece += pieces + (lanes if end[0] else 0)
                    held[piece] += 1
                if f.entry[v] or f.mode[v] in (Mode.ENTERING, Mode.LEAVING):
                    held[pieces + 2 * lanes + f.door[v]] += 1
            assert (held == f.held).all(), f"after {step0 / 10:.0f} s"
