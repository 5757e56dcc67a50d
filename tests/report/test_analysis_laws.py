"""Laws of what the report adds: time, speeding, near misses, money."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from drawn_trucks import T0, crossing, random_truck, rows, straight
from hypothesis import assume, given
from hypothesis import strategies as st

from fleetlog.analysis.near_misses import near_misses, time_to_contact
from fleetlog.analysis.speeding import speeding
from fleetlog.analysis.tariff import Tariff, costs, load_tariff
from fleetlog.analysis.utilisation import STATES, intervals, quarters, row_states, utilisation
from fleetlog.core.site import Frame, Site, Zone
from fleetlog.errors import InputError
from fleetlog.report.facts import consumption
from fleetlog.store import Dataset, DatasetWriter

SQUARE = np.array([[0.0, -5.0], [30.0, -5.0], [30.0, 5.0], [0.0, 5.0]])


@given(st.integers(0, 10_000))
def test_states_partition_the_time_of_a_truck(seed: int) -> None:
    truck = random_truck(seed)
    found = intervals(truck)
    stamps = found[["start", "end"]].astype("datetime64[us, UTC]").astype("int64").to_numpy()
    assert stamps[0, 0] == truck.time[0] and stamps[-1, 1] == truck.time[-1]
    assert (stamps[1:, 0] == stamps[:-1, 1]).all() and (stamps[:, 1] > stamps[:, 0]).all()
    assert set(found["state"]) <= set(STATES)


@given(st.integers(0, 10_000))
def test_quarters_of_an_hour_partition_the_intervals(seed: int) -> None:
    found = intervals(random_truck(seed))
    cut = quarters(found)
    for state in STATES:
        sums = [(t.end - t.start)[t.state == state].sum() for t in (found, cut)]
        assert sums[0] == sums[1]
    assert (cut.start.dt.floor("15min") == (cut.end - pd.Timedelta(1, "us")).dt.floor("15min")).all()


def story(*acts: tuple[float, dict[str, float]]):
    """Rows every second, act by act."""
    columns: dict[str, list[float]] = {}
    for seconds, values in acts:
        for name in ("speed", "payload", "fork_height", "battery_power", "soc"):
            columns.setdefault(name, []).extend([values.get(name, 0.0)] * round(seconds))
    n = len(columns["speed"])
    return rows("T1", np.arange(n), x=0.0, y=0.0, heading=0.0, **{k: np.array(v) for k, v in columns.items()})


def test_a_shift_told_in_rows_is_read_as_told() -> None:
    truck = story(
        (60, {"speed": 2.0}), (10, {}), (10, {"payload": 800.0}), (60, {"speed": 2.0, "payload": 800.0}),
        (40, {"payload": 800.0}), (30, {"speed": 2.0, "payload": 800.0}), (30, {"speed": 2.0}),
        (300, {"battery_power": -3000.0}), (30, {"speed": 2.0}), (200, {"battery_power": 200.0}),
    )  # fmt: skip
    hours = intervals(truck)
    told = hours.assign(s=(hours.end - hours.start).dt.total_seconds())[["state", "s"]].to_numpy().tolist()
    assert [s for s, _ in told] == [
        "driving_empty", "handling", "driving_laden", "waiting", "driving_laden", "driving_empty", "charging",
        "driving_empty", "idle",
    ]  # fmt: skip
    assert dict(told[:3]) == {"driving_empty": 60.0, "handling": 20.0, "driving_laden": 60.0}


def test_a_truck_waits_before_it_takes_a_load_up_and_is_idle_after_it_has_set_one_down() -> None:
    load = {"payload": 800.0}
    truck = story(
        (30, {"speed": 2.0}), (60, {}), (20, load), (30, {"speed": 2.0, **load}), (20, load), (60, {}),
        (30, {"speed": 2.0}), (50, {}), (30, {"speed": 2.0}),
    )  # fmt: skip
    assert intervals(truck)["state"].tolist() == [
        "driving_empty", "waiting", "handling", "waiting", "driving_laden", "waiting", "handling", "idle",
        "driving_empty", "waiting", "driving_empty",
    ]  # fmt: skip


@pytest.mark.parametrize("rate", [20, 10, 5, 1])
def test_a_lift_is_handling_however_often_the_log_has_rows(rate: int) -> None:
    """The forks rise at 0.38 m/s for 5 s: 2 cm from row to row at 20 Hz."""
    t = np.arange(0.0, 100.0, 1.0 / rate)
    lift = np.clip(t - 50.0, 0.0, 5.0)
    moves = np.where((t < 45.0) | (t >= 65.0), 2.0, 0.0)
    for channel in ({"fork_height": 0.1 + 0.38 * lift}, {"payload": 100.0 * lift}):
        truck = rows("T1", t, x=0.0, y=0.0, heading=0.0, speed=moves, **channel)
        found = intervals(truck)
        lasts = (found.end - found.start).dt.total_seconds().groupby(found.state).sum()
        assert lasts["handling"] == pytest.approx(20.0, abs=1.1)


def test_a_truck_without_load_and_forks_is_not_said_to_handle_or_to_wait() -> None:
    truck = rows(
        "T1", np.arange(100), speed=np.repeat([2.0, 0.0, 2.0], [40, 20, 40]), x=0.0, y=0.0, heading=0.0
    )
    assert {STATES[k] for k in row_states(truck)[0]} == {"driving", "standing"}


def test_utilisation_of_a_fleet_adds_up(write) -> None:
    d = write([random_truck(k) for k in range(3)])
    result = utilisation(d)
    spans = sum(float(d.read(v).time[-1] - d.read(v).time[0]) for v in d.vehicles) / 3.6e9
    assert sum(result.summary["hours"].values()) == pytest.approx(spans)
    assert sum(v for v in result.summary["shares"].values()) == pytest.approx(1.0)


def test_energy_used_and_charged_are_the_integral_of_power(write) -> None:
    trucks = [random_truck(k) for k in range(3)]
    table = consumption(write(trucks))
    total = sum(
        float(
            (
                t.floats("battery_power")[:-1] * np.where(np.diff(t.time) <= 60e6, np.diff(t.time), 0) * 1e-6
            ).sum()
        )
        for t in trucks
    )
    assert (table.used_kwh.sum() - table.charged_kwh.sum()) * 3.6e6 == pytest.approx(total)


@given(st.integers(0, 1000), st.integers(0, 300))
def test_tasks_count_for_energy_where_power_is_known(seed: int, rest: int) -> None:
    """A half without power adds hours that were logged, and neither energy nor tasks to a share of them."""
    truck = random_truck(seed)
    known = np.arange(len(truck)) < rest
    half = truck.with_columns(battery_power=np.where(known, truck.floats("battery_power"), np.nan))
    at = pd.to_datetime(truck.time[[40, 200]] + 1, unit="us", utc=True)
    tasks = pd.DataFrame({"vehicle_id": truck.vehicle_id, "start": at})
    with TemporaryDirectory() as folder:
        with DatasetWriter.create(Path(folder) / "d", "recorded", Site("s", Frame(50.0, 9.0))) as w:
            w.write(half)
        table = consumption(Dataset(Path(folder) / "d"), tasks).sum()
    dt = np.where(np.diff(truck.time) <= 60e6, np.diff(truck.time), 0) / 3.6e9
    assert table.energy_tasks == sum(rest > k and dt[k] > 0.0 for k in (40, 200))
    assert table.energy_h == pytest.approx(dt[known[:-1]].sum())
    assert table.logged_h == pytest.approx(dt.sum())


def test_a_drive_above_the_limit_lasts_as_long_as_it_does(write) -> None:
    site = Site("s", Frame(50.0, 9.0), zones=(Zone("hall", SQUARE, 2.0),))
    d = write([straight("fast", (-10, 0), (3.0, 0), 20.0), straight("slow", (-10, 0), (2.1, 0), 20.0)], site)
    found = speeding(d)
    table = found.places["speeding"]
    assert table.vehicle_id.tolist() == ["fast"] and table.place.tolist() == ["hall"]
    assert table.duration[0] == pytest.approx(10.0, abs=0.51)  # 30 m at 3 m/s
    assert found.summary["over_s"] <= found.summary["limited_s"]
    wide = replace(site, zones=(Zone("hall", SQUARE, 3.0),))
    assert speeding(write([straight("fast", (-10, 0), (3.0, 0), 20.0)], wide, "e")).summary["events"] == 0


@given(st.floats(3.0, 50.0), st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_time_to_contact_of_a_head_on_course_is_gap_over_closing_speed(
    gap: float, one: float, two: float
) -> None:
    at, velocity = np.array([gap + 0j]), np.array([-one - two + 0j])
    assert time_to_contact(at, velocity, 1.2)[0] == pytest.approx((gap - 1.2) / (one + two))
    assert time_to_contact(-at, -velocity, 1.2) == time_to_contact(at, velocity, 1.2)
    assert np.isinf(time_to_contact(at, -velocity, 1.2)[0])


@pytest.mark.parametrize("delay", [1.8, 2.2])
def test_post_encroachment_time_of_crossing_trucks(write, delay: float) -> None:
    """The tail leaves the crossing half a length after the middle, the nose comes half a length before it."""
    found = near_misses(write(crossing(delay)), pet=1.5, ttc=0.1).places["near_misses"]
    assert len(found) == 1 and found.kind[0] == "crossing"
    assert found.pet_s[0] == pytest.approx(delay - 2.5 / 2.0, abs=1e-5)


@given(
    st.floats(0.05, 1.95), st.floats(35.0, 145.0), st.floats(0.8, 4.0), st.floats(0.8, 4.0), st.floats(0.0, 1.0),
    st.sampled_from([0.3, 1.0, 2.0]),
)  # fmt: skip
def test_crossings_are_found_below_the_limit_and_not_above_it(
    tmp_path_factory, pet: float, turn: float, one: float, two: float, phase: float, dt: float
) -> None:
    """Whatever the speeds, the angle, the rows and their phase: the time from tail to nose is that of the drives."""
    assume(abs(pet - 1.0) > 1e-3)
    angle = np.radians(turn)
    way = two * np.array([np.cos(angle), np.sin(angle)])
    a = straight("A", (-10.0 * one, 0.0), (one, 0.0), 20.0, dt)
    # From the first row of B until its middle is at the crossing.
    late = 10.0 + 1.25 / one + pet + 1.25 / two - phase
    b = straight("B", -late * way, way, late + 10.0, dt, phase)
    path = tmp_path_factory.mktemp("d") / "d"
    with DatasetWriter.create(path, "recorded", Site()) as w:
        for truck in (a, b):
            w.write(truck)
    found = near_misses(Dataset(path), ttc=0.0).places["near_misses"]
    assert len(found) == (pet < 1.0)
    if len(found):
        assert found.pet_s[0] == pytest.approx(pet, abs=1e-4) and found.kind[0] == "crossing"
        assert np.hypot(found.x[0], found.y[0]) < 1e-3


def test_a_truck_whose_heading_is_unknown_is_in_the_way(write) -> None:
    """A parked truck never tells its heading, but where it stands is known."""
    parked = rows("B", range(21), x=0, y=0, speed=0)
    found = near_misses(write([straight("A", (-20, 0), (2.0, 0), 20.0), parked]))
    assert found.summary["near_misses"] == 1
    assert found.places["near_misses"].x[0] == pytest.approx(-1.5, abs=0.7)


def test_rows_seconds_apart_tell_no_near_miss(write) -> None:
    """Between them a truck is on no known spot at no known second: the answer is unknown, not none and not many."""
    for dt, told in ((0.5, 1), (2.0, 1), (4.0, None)):
        a = straight("A", (-20.0, 0.0), (2.0, 0.0), 20.0, dt)
        b = straight("B", (0.0, -21.8), (0.0, 2.0), 24.0, dt)
        found = near_misses(write([a, b], name=f"every {dt}"))
        assert found.summary["near_misses"] == told
    assert found.lines == ["Near misses: unknown, as all rows are more than 2.5 s apart."]


def test_trucks_far_apart_in_time_or_place_do_not_meet(write) -> None:
    assert not len(near_misses(write(crossing(8.0))).places["near_misses"])
    parallel = [straight("A", (0, 0), (2.0, 0), 20.0), straight("B", (40, 2.5), (-2.0, 0), 20.0)]
    assert not len(near_misses(write(parallel, name="e")).places["near_misses"])


def test_a_truck_in_a_bay_of_a_simulation_is_beside_the_road(write) -> None:
    """After a recording the simulator draws bays where trucks stood, on the road: others pass beside them."""
    passing, standing = (
        straight("A", (-20, 0), (2.0, 0), 20.0),
        rows("B", range(21), x=0, y=0, heading=0, speed=0),
    )
    d = write([passing, standing])
    assert near_misses(d).places["near_misses"].kind.tolist() == ["behind"]
    for x, left in ((0.0, 0), (3.0, 1)):
        pd.DataFrame({"place": ["p"], "x": [x], "y": [0.0]}).to_parquet(d.path / "bays.parquet")
        d.meta["tables"] = {"bays": {"file": "bays.parquet"}}
        assert len(near_misses(d).places["near_misses"]) == left


@pytest.mark.parametrize(
    "delay, figures", [(0.9, ["ttc_s", "closing_speed"]), (2.0, ["pet_s", "closing_speed"])]
)
def test_a_near_miss_is_symmetric_and_moves_with_the_site(write, delay: float, figures: list[str]) -> None:
    one, two, three = (
        near_misses(write(trucks, name=n), pet=1.5).places["near_misses"]
        for n, trucks in (
            ("a", crossing(delay)), ("b", crossing(delay, names=("B", "A"))),
            ("c", crossing(delay, np.pi / 2, (100.0, -40.0))),
        )
    )  # fmt: skip
    assert len(one) == len(two) == len(three) == 1
    pd.testing.assert_frame_equal(one[[*figures, "x", "y", "kind"]], two[[*figures, "x", "y", "kind"]])
    np.testing.assert_allclose(one[figures].astype(float), three[figures].astype(float), atol=1e-5)


def test_a_head_on_course_is_seen_when_it_is_short_of_time(write) -> None:
    d = write([straight("A", (0, 0), (2.0, 0), 9.6, 0.2), straight("B", (40.9, 0), (-2.0, 0), 9.6, 0.2)])
    found = near_misses(d, ttc=1.0).places["near_misses"]
    assert found.kind.tolist() == ["head-on"] and found.closing_speed[0] == pytest.approx(4.0)
    # They end 2.5 m and one bumper apart.
    assert 0.0 < found.ttc_s[0] < 0.3


flat = st.floats(0.01, 2.0)


@given(flat, st.lists(st.floats(0.0, 5.0), min_size=1, max_size=50), st.booleans())
def test_with_one_flat_price_the_cost_is_energy_times_price(
    price: float, used: list[float], charged: bool
) -> None:
    tariff = Tariff(np.full((7, 24), price), np.full((7, 24), 0.4))
    local = pd.Series(pd.date_range("2026-03-02", periods=len(used), freq="h"))
    cost, co2 = costs(pd.Series(used), pd.Series(used[::-1]) * charged, local, tariff)
    assert cost.sum() == pytest.approx(price * sum(used)) and co2.sum() == pytest.approx(0.4 * sum(used))


def test_energy_is_paid_at_the_hours_in_which_it_was_charged(tmp_path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(
        "price = 0.3\nco2 = 0.5\ncharger_efficiency = 0.8\n[[period]]\nfrom = 22\nto = 6\nprice = 0.1\n"
    )
    local = pd.Series(pd.to_datetime(["2026-03-02 12:00", "2026-03-02 23:00", "2026-03-03 05:59"]))
    night = costs(pd.Series([1.0, 0.0, 0.0]), pd.Series([0.0, 2.0, 2.0]), local, load_tariff(path))
    assert night[0].sum() == pytest.approx(0.1 / 0.8) and night[1].sum() == pytest.approx(0.5 / 0.8)


@pytest.mark.parametrize(
    "text, what",
    [
        ("prise = 1", "prise"), ("co2 = 0.4", "price is missing"), ("price = nan", "not a finite number"),
        ("price = 1\nperiod = 3", "list of tables"),
        ('price = 1\n[[period]]\nfrom = 25\nto = 2\nprice = 1', "from 0 to 23"),
        ('price = 1\n[[period]]\nfrom = 2\nto = 3\nprice = 1\ndays = ["lundi"]', "lundi"),
    ],
)  # fmt: skip
def test_a_wrong_tariff_names_the_key(tmp_path, text: str, what: str) -> None:
    (tmp_path / "t.toml").write_text(text)
    with pytest.raises(InputError, match=what) as error:
        load_tariff(tmp_path / "t.toml")
    assert len(error.value.line().splitlines()) == 1


def test_a_week_has_every_hour_once(tmp_path) -> None:
    from fleetlog.analysis.tariff import load_tariff

    def dear(period: str):
        (tmp_path / "tariff.toml").write_text(f"price = 1.0\n[[period]]\n{period}\nprice = 2.0\n")
        return load_tariff(tmp_path / "tariff.toml").price == 2.0

    assert dear("from = 0\nto = 24").all() and dear("from = 0\nto = 0").all()
    night = dear('from = 22\nto = 6\ndays = ["fri"]')
    assert night.sum() == 8 and night[4, 22:].all() and night[5, :6].all()
    sunday = dear('from = 22\nto = 6\ndays = ["sun"]')
    assert sunday.sum() == 8 and sunday[6, 22:].all() and sunday[0, :6].all()
    assert not T0 % 1_000_000
