"""Laws that the parts of the diagnosis keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fleetlog.core.motion import Motion
from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.core.truck import Chassis, Truck
from fleetlog.discovery import explain
from fleetlog.discovery.channels.base import Channel
from fleetlog.discovery.channels.choose import channel_of
from fleetlog.discovery.channels.energy import _recorded
from fleetlog.discovery.channels.energy_columns import Evaluation
from fleetlog.discovery.channels.paths import Drive, _lay_out, across, kinks
from fleetlog.discovery.channels.paths import Path as DrivenPath
from fleetlog.discovery.channels.travel import TravelChannel
from fleetlog.discovery.channels.waits import Waits
from fleetlog.discovery.hypotheses.cells import make_squares, make_stretches
from fleetlog.discovery.hypotheses.hypothesis import Hypothesis, Pattern, _numbers
from fleetlog.discovery.hypotheses.sources import FreeCurve, Layout
from fleetlog.discovery.model import FLEET, Knob, Model, Scope
from fleetlog.discovery.recording.blocks import block, cut
from fleetlog.discovery.recording.day import Day
from fleetlog.discovery.recording.fleet import Fleet, read_fleet
from fleetlog.discovery.recording.sensors import examine
from fleetlog.discovery.recording.splits import make_split
from fleetlog.discovery.recording.turns import Turn, _as_gathered, _map_explains, crossings, measure
from fleetlog.discovery.report.fields import PART, Values, as_field, together, told
from fleetlog.discovery.report.finding import NORMAL, ChannelFit, Parameter
from fleetlog.discovery.report.words import statement
from fleetlog.discovery.search import finish, forward
from fleetlog.discovery.search import joint as joint_fit
from fleetlog.discovery.search.beside import Screened, _best
from fleetlog.discovery.search.design import Atom, Design
from fleetlog.discovery.search.finish import Search
from fleetlog.discovery.search.joint import Joint
from fleetlog.discovery.search.judge import beyond_chance
from fleetlog.discovery.search.problem import Problem
from fleetlog.discovery.search.ridge import Sums
from fleetlog.discovery.settings import SETTINGS
from fleetlog.physics.motion.legs import Leg
from fleetlog.physics.power import Physics, all_terms, battery_power
from fleetlog.store import Dataset, DatasetWriter

TRUCK = Truck(Chassis(4500.0))


def network():
    """Two roads of 40 m at a right angle, both ways."""
    a = Edge("a", "n0", "n1", np.array([[0.0, 0, 0], [40.0, 0, 0]]), "a", 3.0)
    b = Edge("b", "n1", "n2", np.array([[40.0, 0, 0], [40.0, 40.0, 0]]), "b", 3.0)
    return build_network([a, reversed_edge(a), b, reversed_edge(b)])


def drive(rows: int = 600, seed: int = 0, step: float = 1.0) -> Trajectory:
    """A truck that sets off and stops every half minute, its power that of the nominal model."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * step
    speed = np.clip(np.minimum((t % 30) * 0.6, (30 - t % 30) * 0.7), 0, rng.uniform(2.5, 3.5))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step)])
    columns = {"x": way, "y": np.zeros(rows), "heading": np.zeros(rows), "speed": speed,
               "payload": np.full(rows, 500.0), "trip_id": (t // 30).astype(np.int64)}  # fmt: skip
    track = Trajectory("T", (t * 1e6).astype(np.int64), columns)
    b = block(track, 0, None, TRUCK)
    return track.with_columns(battery_power=b.rows(battery_power(b.motion, Physics(TRUCK))))


def bent(angle: float):
    """A road of two straights of 20 m that meet at an angle [rad], one way."""
    end = [20.0 + 20.0 * np.cos(angle), 20.0 * np.sin(angle), 0.0]
    return build_network([Edge("a", "n0", "n1", np.array([[0.0, 0, 0], [20.0, 0, 0], end]), "a", 3.0)])


@pytest.mark.parametrize("angle", [0.06, -0.3])
def test_a_kink_of_the_map_is_one_turn_within_a_metre(angle: float) -> None:
    """The curvature of a truck that follows the line turns it by the angle of the kink, and nowhere else."""
    s = np.arange(0.005, 40.0, 0.01)
    curvature = kinks(bent(angle), np.zeros(len(s), int), s)
    assert (curvature * 0.01).sum() == pytest.approx(abs(angle), rel=0.02)
    assert (np.abs(s[curvature > 0.0] - 20.0) < 0.51).all()


@pytest.mark.parametrize("angle", [0.0, 1.2])
def test_straights_have_no_kinks_and_corners_are_rounded(angle: float) -> None:
    assert not kinks(bent(angle), np.zeros(50, int), np.linspace(0.0, 40.0, 50)).any()


def test_windows_keep_the_energy_and_never_straddle_a_trip() -> None:
    b = block(drive(), 0, None, TRUCK)
    c = cut(b, 10.0)
    power = battery_power(b.motion, Physics(TRUCK))
    assert c.energy(power).sum() == pytest.approx((power * b.motion.dt).sum() * 1e-3)
    for w in range(c.count):
        assert len(np.unique(b.trip[c.of_row == w])) == 1


@pytest.mark.parametrize("power", [470.0, -4000.0])
@pytest.mark.parametrize(("rate", "full"), [(-2e-6, np.inf), (1e-4, np.inf), (1e-4, 0.81)])
def test_a_charge_that_rises_at_standstill_is_left_out_whether_or_not_its_power_is_logged(
    rate: float, full: float, power: float
) -> None:
    """Nor does it matter that a charge above what may be is not known."""
    track, t = drive(600), np.arange(840.0)
    still = t >= 600
    columns = {name: np.append(values, np.full(240, values[-1])) for name, values in track.columns.items()}
    columns["speed"][still], columns["battery_power"][still] = 0.0, power
    columns["soc"] = 0.8 - 4e-6 * np.minimum(t, 600) + rate * np.maximum(t - 600, 0)
    columns["soc"][columns["soc"] > full] = np.nan
    b = block(Trajectory("T", (t * 1e6).astype(np.int64), columns), 0, None, TRUCK)
    c = cut(b, 10.0)
    known = np.isfinite(_recorded(c, "soc", 3600.0 * TRUCK.battery.capacity_wh, 0.5))
    begin = c.of_row[604]
    assert known[:begin].all() and (known[begin + 1 :] == (rate < 0 and power > 0)).all()


def rows_late(t: np.ndarray, fine: Trajectory, shift: float) -> np.ndarray:
    """(N,) the mean power over the second around each row, by a clock that is so many seconds late."""
    at, power = fine.seconds(), fine.floats("battery_power")
    energy = np.concatenate([[0.0], np.cumsum(power)]) * 0.1
    ends = np.append(at - 0.05, at[-1] + 0.05)
    begin = t - shift - 0.5
    return np.interp(begin + 1.0, ends, energy) - np.interp(begin, ends, energy)


def fleet(shift: float = 0.0) -> Fleet:
    """Two trucks whose power is logged so many seconds late."""
    days = []
    for k in range(2):
        track = drive(1200, k)
        late = rows_late(track.seconds(), drive(12000, k, 0.1), shift)
        days.append(Day(k, track.with_columns(battery_power=late)))
    return Fleet(days, ("a", "b"), None, TRUCK, {}, {})


def faults(f: Fleet):
    """What is wrong with its sensors."""
    return examine(f, make_split("trips", f.trips, f.seconds, [0, 1], [0], 10, 0.2, 0))[1]


@given(st.floats(-8.0, 8.0).filter(lambda s: abs(s) > 1.0))
@example(1.125)
@settings(max_examples=6, deadline=None)
def test_a_late_clock_is_found(shift: float) -> None:
    (fault,) = faults(fleet(shift))
    assert fault.term == "clock_offset"
    assert fault.off.value == pytest.approx(shift, abs=0.2)


def test_a_right_clock_is_no_fault() -> None:
    assert faults(fleet()) == []


def test_a_late_clock_is_no_mean_where_rows_are_seconds_apart() -> None:
    """Trucks start and brake between the rows: shifts are tried as finely as they do."""
    days = []
    for k in range(2):
        rng = np.random.default_rng(k)
        t, ends = np.arange(60_000) * 0.1, np.cumsum(rng.uniform(20.0, 50.0, 400))
        trip = np.searchsorted(ends, t)
        since, left = t - np.append(0.0, ends)[trip], ends[trip] - t
        speed = np.clip(np.minimum(since * 0.6, left * 0.7), 0.0, rng.uniform(1.5, 3.5, 400)[trip])
        way = np.cumsum(speed) * 0.1
        columns = {
            "x": way,
            "y": 0.0 * way,
            "heading": 0.0 * way,
            "speed": speed,
            "payload": 0.0 * way,
            "trip_id": trip,
        }
        fine = Trajectory("T", np.round(t * 1e6).astype(np.int64), columns)
        b = block(fine, 0, None, TRUCK)
        fine = fine.with_columns(battery_power=b.rows(battery_power(b.motion, Physics(TRUCK))))
        rows = fine[::50]
        days.append(Day(k, rows.with_columns(battery_power=rows_late(rows.seconds(), fine, 3.1))))
    (fault,) = faults(Fleet(days, ("a", "b"), None, TRUCK, {}, {}))
    assert fault.term == "clock_offset"
    assert fault.off.value == pytest.approx(3.1, abs=0.4)


def test_what_a_few_trips_have_is_no_error_beyond_chance() -> None:
    """Half of the squares are one trip's: other trips might have had none. An even error is nearly all told."""
    trip, rng = np.repeat(np.arange(20), 40), np.random.default_rng(0)
    even = rng.normal(0.0, 1.0, len(trip))
    rare = np.where(trip == 7, 4.5, 1.0) * even
    assert 0.9 < beyond_chance(even, trip) < np.sqrt(np.mean(even**2))
    assert beyond_chance(rare, trip) < 0.6 * np.sqrt(np.mean(rare**2))


def test_noise_of_a_speed_at_rest_is_no_scale() -> None:
    """A truck that stands half of the time: the noise of a speed that is never negative adds up to metres."""
    t, rng = np.arange(4000.0), np.random.default_rng(3)
    true = np.where(t % 40.0 < 20.0, 2.0, 0.0)
    x = np.cumsum(true) + rng.normal(0.0, 0.01, len(t))
    speed = np.abs(true + rng.normal(0.0, 0.08, len(t)))
    columns = {"x": x, "y": np.zeros(len(t)), "speed": speed}
    days = [Day(0, Trajectory("T", (t * 1e6).astype(np.int64), columns))]
    assert faults(Fleet(days, ("a",), None, TRUCK, {}, {})) == []


@pytest.mark.parametrize(
    "name",
    [
        "rolling_resistance", "grade", "thermal_load", "payload", "drivetrain_efficiency", "cornering_resistance", "mass",
        "copper_loss", "enabled_load",
    ],
)  # fmt: skip
def test_a_changed_term_is_the_difference_of_two_sums(name: str) -> None:
    """The short cut of one term must agree with the whole sum evaluated twice."""
    rng = np.random.default_rng(1)
    motion = Motion.of(200, speed=rng.uniform(0, 4, 200), acceleration=rng.normal(0, 0.5, 200), payload=800.0,
                       curvature=rng.normal(0, 0.1, 200), ambient_temperature=5.0)  # fmt: skip
    before = Physics(TRUCK, {"auxiliary_load": {"power": 700.0}})
    term = all_terms()[name]
    parameter = term.parameters[0]
    value = 0.5 * (parameter.low + parameter.high)
    after = Physics(TRUCK, {**before.values, name: {parameter.name: value}})
    expected = battery_power(motion, after) - battery_power(motion, before)
    assert Evaluation(motion, before).change(term, {parameter.name: value}) == pytest.approx(
        expected, abs=1e-6
    )


def test_an_odd_field_has_opposite_values_in_the_two_directions() -> None:
    net = network()
    cells = make_stretches(net)
    field = np.random.default_rng(0).normal(size=len(cells))
    there = Motion.of(1, edge=net.edge("a"), edge_offset=11.0)
    back = Motion.of(1, edge=net.edge("-a"), edge_offset=29.0)
    for odd, sign in ((True, -1.0), (False, 1.0)):
        own = replace(cells, odd=odd)
        assert own.along(there, field)[0] == pytest.approx(sign * own.along(back, field)[0])


def test_a_pattern_is_the_same_in_the_basis_of_the_prior() -> None:
    """Whole roads but for the finest modes, which are 5 % of the variance; what is not alike has all."""
    roads, lanes = make_stretches(network()), make_stretches(network(), apart=True)
    assert roads.root.shape[1] < len(roads) and lanes.root.shape[1] == len(lanes)
    for cells, near in ((roads, 0.05), (lanes, 1e-9)):
        pattern = np.where(cells.road_edge == 0, 1.0, -2.0)
        assert cells.root @ (cells.inverse @ pattern) == pytest.approx(pattern, rel=near)


def test_the_largest_slope_is_that_of_twelve_metres_as_less_is_hardly_told_from_the_next() -> None:
    """Errors of neighbours that cancel leave the mean of three nearly as it is; alone one seems to have 5 %."""
    cells = replace(make_stretches(network()), odd=True)
    slope = np.where(cells.road_edge == 0, 0.04, 0.0) + 0.01 * (-1.0) ** np.arange(len(cells))
    slope[cells.road_edge != 0] = 0.0
    apart = np.eye(len(cells)) - 0.95 * (np.eye(len(cells), k=1) + np.eye(len(cells), k=-1)) / 2.0
    values = Values(slope, np.full(len(cells), 10), np.eye(len(cells)), *[0.001**2 * apart] * 2)
    _, (steepest,) = told(cells, values, Hypothesis("grade", field=True))
    assert steepest.value == pytest.approx(0.04, rel=0.1)


def test_what_a_prior_leaves_open_does_not_make_the_largest_slope_smaller() -> None:
    """Even hills, measured well in windows of ten stretches each: what single stretches have of their own is
    left open by the windows, and drawn to zero by the prior.  It is no noise that picking would add."""
    cells, rng, told_of = replace(make_stretches(network()), odd=True), np.random.default_rng(1), []
    size, along = 3.0 * cells.root, (cells.start + cells.end) / 2.0
    windows = np.repeat(np.eye(2), 10, axis=1) / 10.0
    gram = (windows @ size).T @ (windows @ size) / 0.002**2
    known = np.linalg.inv(gram + np.eye(size.shape[1]) / 0.02**2)
    count = max(1, round(PART / float(np.mean(cells.end - cells.start))))
    for _ in range(30):
        slope = rng.uniform(0.02, 0.06) * np.sin(np.pi * along / cells.end.max())
        found = size @ known @ size.T @ windows.T @ (windows @ slope + 0.002 * rng.normal(size=2)) / 0.002**2
        largest = np.convolve(slope, np.ones(count) / count, "valid").max()
        values = Values(found, np.full(len(cells), 10), size, known, known @ gram @ known)
        for v in (values, replace(values, scatter=known)):
            _, (steepest,) = told(cells, v, Hypothesis("grade", field=True))
            told_of.append((steepest.value / largest, steepest.low <= largest <= steepest.high))
    ratio, held = np.array(told_of, float).reshape(30, 2, 2).transpose(2, 1, 0)
    assert held[0].mean() > 0.9
    assert 0.6 < ratio[0].min() < ratio[0].max() < 1.0
    assert ratio[1].min() < 0.2  # If all were scatter


def test_squares_hold_a_vector_for_an_odd_field() -> None:
    rng = np.random.default_rng(0)
    squares = make_squares(rng.uniform(0, 60, 500), rng.uniform(0, 60, 500))
    assert squares is not None
    squares = replace(squares, odd=True)
    values = np.tile([0.03, 0.0], len(squares))
    east, north, west = (
        squares.along(Motion.of(1, x=30.0, y=30.0, heading=h), values)[0] for h in (0.0, np.pi / 2, np.pi)
    )
    assert (east, north, west) == pytest.approx((0.03, 0.0, -0.03), abs=1e-12)


def test_what_a_road_does_not_follow_widens_no_interval() -> None:
    """One square whose slope is known to 1 % along a diagonal road, and not at all across it."""
    road, across = np.array([1.0, 1.0]) / np.sqrt(2.0), np.array([1.0, -1.0]) / np.sqrt(2.0)
    covariance = 0.01**2 * np.outer(road, road) + 1.0 * np.outer(across, across)
    v = Values(0.05 * road, np.array([7, 9]), np.eye(2), covariance, covariance)
    along = v.along(road[None, :])
    assert along.deviation == pytest.approx([0.05])
    assert along.error == pytest.approx([0.01])
    assert along.samples.tolist() == [9]
    assert v.along(across[None, :]).error == pytest.approx([1.0])


@pytest.mark.parametrize("name", ["grade", "surface_resistance"])
def test_a_field_of_squares_is_read_as_it_was_found(name: str) -> None:
    """At every place of a square, its corners too, whatever the size; along the roads exactly, where each
    value is as sure as it is along its road."""
    rng, term = np.random.default_rng(0), all_terms()[name]
    x, y = rng.uniform(0.0, 900.0, (2, 5000))
    squares = make_squares(x, y)
    assert squares is not None and squares.side > 40.0
    squares, width = replace(squares, odd=term.odd), 2 if term.odd else 1
    roads = rng.uniform(-np.pi, np.pi, len(squares))
    along, across = (
        np.stack([np.cos(roads), np.sin(roads)], axis=1),
        np.stack([-np.sin(roads), np.cos(roads)], axis=1),
    )
    deviation = rng.uniform(0.01, 0.05, len(squares) * width)
    covariance = 1e-4 * np.eye(len(deviation))
    for i in range(len(squares) if term.odd else 0):
        part = slice(2 * i, 2 * i + 2)
        covariance[part, part] = 1e-6 * np.outer(along[i], along[i]) + 1.0 * np.outer(across[i], across[i])
    passes = np.full(len(deviation), 9)
    field = as_field(squares, Values(deviation, passes, np.eye(len(deviation)), covariance, covariance), term)
    neutral = term.parameters[0].neutral
    cell, _ = squares.at(Motion.of(len(x), x=x, y=y))
    motion = Motion.of(len(x), x=x, y=y, heading=roads[cell], edge=np.full(len(x), -1, np.int32))
    assert field.along(motion, neutral) == pytest.approx(neutral + squares.along(motion, deviation))
    if term.odd:
        narrow = field[np.abs(np.angle(np.exp(1j * (field.heading - np.tile(roads, 8))))) < 1e-6]
        assert len(narrow) == len(squares)
        assert narrow.high - narrow.low == pytest.approx(2.0 * NORMAL * 1e-3, rel=1e-6)


def test_without_positions_nothing_that_follows_the_heading_is_offered() -> None:
    def terms(track: Trajectory) -> tuple[set[str], set[str]]:
        fleet = Fleet([Day(0, track)], ("T",), None, TRUCK, {}, {})
        split = make_split("trips", fleet.trips, fleet.seconds, [0], list(fleet.dates), 5, 0.2, 0)
        channel = channel_of("battery_power", fleet, Model(TRUCK), SETTINGS, split)
        curves = {v for c in channel.curves() for v in c.variables}
        return {t.name for t in channel.terms()}, curves

    track = drive(3000)
    named, curves = terms(track)
    assert {"wind", "grade"} <= named
    assert "heading" in curves
    nowhere = Trajectory(
        "T", track.time, {k: v for k, v in track.columns.items() if k not in ("x", "y", "heading")}
    )
    named, curves = terms(nowhere)
    assert "rolling_resistance" in named
    assert not {"wind", "grade"} & named
    assert "heading" not in curves


def test_a_withheld_column_is_not_read(tmp_path: Path) -> None:
    track = drive().with_columns(z=np.linspace(0.0, 9.0, 600))
    with DatasetWriter.create(tmp_path / "d", "recorded", Site("s")) as writer:
        writer.write(track)
    data = Dataset(tmp_path / "d")
    slope = [
        abs(next(f.each_block(f.dates[0]))[1].motion.slope).max()
        for f in (read_fleet(data, TRUCK, without=w) for w in ((), ("z",)))
    ]
    assert slope[0] > 0.0 == slope[1]


def turn(angle: float, speed: float, length: float, corner: float) -> Turn:
    return Turn(angle, length, speed, 4.0, corner)


@pytest.mark.parametrize("lateral", [0.4, 1.2, 2.5])
@pytest.mark.parametrize("own", [True, False])
def test_turns_are_measured_where_the_map_does_not_tell_where_trucks_slow_down(
    lateral: float, own: bool
) -> None:
    """Speeds follow either the bends that trucks drive or the corners of the map, at one lateral acceleration."""
    rng = np.random.default_rng(4)
    known = []
    for _ in range(30):
        angle, length, corner = rng.uniform(0.7, 2.0), rng.uniform(4.0, 12.0), rng.uniform(0.05, 0.5)
        bend = angle / length if own else corner
        speed = min(4.0, np.sqrt(lateral / bend)) * rng.normal(1.0, 0.03)
        known.append(turn(angle, speed, length, corner))
    assert _map_explains(known) is not own


def crossing(angle: float, pace) -> Leg:
    """Sixty metres over a junction in the middle, where the way turns on an arc of 4 m; ``pace`` by distance."""
    s = np.linspace(0.0, 60.0, 121)
    turned = np.clip((s - 28.0) / 4.0, 0.0, 1.0) * angle
    x, y = (np.cumsum(f(turned)) * 0.5 for f in (np.cos, np.sin))
    path = Motion.of(
        len(s),
        x=x,
        y=y,
        heading=turned,
        speed=np.array([pace(v) for v in s]),
        edge=(s > 30.0).astype(np.int32),
    )
    return Leg(s, path, np.zeros(len(s), np.int64), 0.0, True, {})


@pytest.mark.parametrize("angle", [0.0, 1.5])
def test_a_slow_road_behind_a_junction_does_not_make_the_junction_slow(angle: float) -> None:
    """The junction is taken at 2 m/s, from six metres behind it on at 1 m/s."""
    slow = crossing(angle, lambda s: 2.0 if s < 36.0 else 1.0)
    others = [crossing(1.5, lambda s: 2.0) for _ in range(4)]
    for k, leg in enumerate(others):  # Ways of their own, as bends are needed to measure any
        leg.path.edge[:] += 2 + 2 * (k % 3)
    legs = [slow, slow, slow, *(leg for leg in others for _ in range(3))]
    everywhere = [(leg, np.full(121, 3.0), np.ones(121, bool)) for leg in legs]
    assert measure(crossings(everywhere), TRUCK).by_way[0, 1].speed == pytest.approx(2.0)


def ways_beside(leg: Leg, angle: float = 1.5) -> list[tuple[Leg, np.ndarray, np.ndarray]]:
    """Three passages of a way, and of three more with a bend: those are needed to measure any."""
    others = [crossing(angle, lambda s: 2.0) for _ in range(3)]
    for k, other in enumerate(others):
        other.path.edge[:] += 2 + 2 * k
    legs = [leg, *others]
    return [(one, np.full(121, 3.5), np.ones(121, bool)) for one in legs for _ in range(3)]


def giving_way(s: float) -> float:
    """At 2 m/s ten metres before the junction, at 3.5 m/s far from it."""
    rate = 0.8 if s < 20.0 else 0.6
    return min(3.5, np.sqrt(4.0 + 2.0 * rate * abs(s - 20.0)))


def test_where_trucks_slow_down_before_a_junction_is_measured() -> None:
    ((middle, _, speed),) = (
        measure(crossings(ways_beside(crossing(0.0, giving_way))), TRUCK).by_way[0, 1].slow
    )
    assert middle == pytest.approx(-10.0, abs=1.0)
    assert speed == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("slow", [range(61), range(31), range(30, 61)])
def test_a_slow_road_before_or_behind_a_junction_is_no_place_where_trucks_give_way(slow: range) -> None:
    """At 2 m/s on the whole way, before, or behind the junction, and braking for that; else at 3.5 m/s."""

    def pace(s: float) -> float:
        ahead, since = max(slow[0] - s, 0.0), max(s - slow[-1], 0.0)
        return min(3.5, np.sqrt(4.0 + 1.6 * ahead + 1.2 * since))

    assert measure(crossings(ways_beside(crossing(0.0, pace))), TRUCK).by_way[0, 1].slow == ()


def setting_off(rate: float):
    """At 2 m/s in the bend, gathering speed at a ``rate`` behind it; else at 3.5 m/s."""
    return lambda s: min(3.5, np.sqrt(4.0 + 1.6 * max(28.0 - s, 0.0) + 2.0 * rate * max(s - 32.0, 0.0)))


@pytest.mark.parametrize("common", [0.2, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("angle", [0.0, 1.5])
def test_how_fast_trucks_gather_speed_behind_bends_is_told_by_what_ways_have_in_common(
    angle: float, common: float
) -> None:
    """One way of five on which they do so otherwise changes nothing; where no way bends the truck file holds,
    and where they do so hardly more slowly than it says."""
    ways = [crossing(angle, setting_off(rate)) for rate in (0.25, common, common, common, common)]
    seen = [[(leg, np.full(121, 3.5), np.ones(121, bool))] * 3 for leg in ways]
    found = _as_gathered([[one for _, one in crossings(legs)] for legs in seen], TRUCK)
    expected = common if angle and common < 0.4 else TRUCK.drive.max_acceleration
    assert found.drive.max_acceleration == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("straight", "told"), [(0.6, False), (3.5, True)])
def test_who_is_as_slow_straight_on_is_not_slow_for_the_bend(straight: float, told: bool) -> None:
    """Bends at 0.9 m/s tell of lateral acceleration only where trucks that go straight on are faster."""

    def stops(slowest: float):
        return lambda s: min(3.5, np.sqrt(slowest**2 + (1.6 if s < 28.0 else 1.2) * abs(s - 28.0)))

    ways = [crossing(1.5, stops(0.9 + 0.1 * k)) for k in range(3)]
    ways += [crossing(0.0, stops(straight)) for _ in range(3)]
    for k, leg in enumerate(ways):
        leg.path.edge[:] += 2 * k
    seen = [(leg, np.full(121, 3.5), np.ones(121, bool)) for leg in ways for _ in range(3)]
    lateral = measure(crossings(seen), TRUCK).lateral
    assert (lateral < TRUCK.drive.max_lateral_acceleration) is told


def turning_back(s: float) -> float:
    """At 1 m/s for a moment at the end of the road, and braking for that; else at 3.5 m/s."""
    return min(3.5, np.sqrt(1.0 + (1.6 if s < 30.0 else 1.2) * abs(s - 30.0)))


@pytest.mark.parametrize("others", [0, 3])
def test_how_trucks_turn_back_is_known_where_few_did(others: int) -> None:
    """Three passages of one way tell of all, beside bends or where there are none; they are slow for a moment,
    however wide they turn; and only on the edge that leads back."""
    seen = ways_beside(crossing(3.1, turning_back))[: 3 + 3 * others]
    turns = measure(crossings(seen), TRUCK)
    s = np.arange(0.0, 21.0, 0.5)
    edge = np.where(s <= 8.0, 40, 41)
    reverse = np.full(50, -1)
    assert not turns.along(s, edge, 0.0 * s, s > 0.0, reverse).any()
    reverse[40] = 41
    bent = turns.along(s, edge, 0.0 * s, s > 0.0, reverse)
    assert np.sqrt(turns.lateral / bent.max()) == pytest.approx(1.0, abs=0.1)
    assert np.ptp(s[bent > 0.0]) < 2.0


def test_limits_are_shared_where_roads_meet() -> None:
    s = np.arange(0.0, 61.0)
    edge = (s > 30.0).astype(int)
    limit = np.where(edge > 0, 4.5, 2.5)
    shared = across(limit, edge, s, s > 0.0)
    near = np.abs(s - 30.0) < 4.5
    assert shared[near] == pytest.approx(3.5)
    assert (shared == limit)[np.abs(s - 30.0) > 5.5].all()


def driven(
    edge_offset: np.ndarray, inside: np.ndarray, standing: dict[int, float], held: int = -1
) -> DrivenPath:
    """A drive on edge 0, one window a leg, with stops at some nodes."""
    n = len(edge_offset)
    motion = Motion.of(n, edge=np.zeros(n, np.int32), edge_offset=edge_offset)
    stood = np.array([standing.get(k, 0.0) for k in range(n)])
    of, nothing = np.cumsum(~inside) - 1, np.zeros(n, np.float32)
    none = np.zeros(int(of[-1]) + 1, bool)
    on = np.arange(n) == held
    return DrivenPath(
        motion, edge_offset, inside, of, nothing, nothing, stood, on, nothing, nothing, none, none
    )


@pytest.mark.parametrize(("wait", "parts"), [(0.0, [0.5, 0.5]), (9.0, [1.0, 0.0])])
def test_a_stop_for_a_purpose_makes_no_second_passage(wait: float, parts: list[float]) -> None:
    """A truck stops within a stretch, for a purpose or not, and goes on; of less than half nothing is told."""
    lanes = make_stretches(network(), apart=True)
    size = lanes.end - lanes.start
    at = np.linspace(0.01, size[0] - 0.01, 20)
    inside = np.ones(20, bool)
    inside[[0, 10]] = False
    path = driven(at, inside, {9: wait})
    _, passed, share = path.passages(lanes.at(path.motion)[0], size)
    assert passed.tolist() == [True]
    assert [share[:10].sum(), share[10:].sum()] == pytest.approx(parts, abs=0.06)
    late = driven(at[11:], inside[1:10] > 0, {0: 0.0})
    assert late.passages(lanes.at(late.motion)[0], size)[2].sum() == 0.0


@pytest.mark.parametrize(("others", "used"), [(0, [False, True]), (5, [True, True])])
def test_a_stop_where_nobody_else_waits_is_no_time_of_its_road(others: int, used: list[bool]) -> None:
    """Of two windows a truck stands in the first; it counts only if trucks wait at that place."""
    lanes = make_stretches(network(), apart=True)
    inside = np.ones(20, bool)
    inside[[0, 10]] = False
    path = driven(np.linspace(0.01, lanes.end[0] - 0.01, 20), inside, {5: 30.0})
    counts = np.zeros((4, len(lanes)))
    counts[:3, 0] = 20.0, others, 30.0 * others
    still = SimpleNamespace(seconds=np.zeros(20), waits=np.zeros(20))
    channel = SimpleNamespace(
        waits=Waits(lanes, counts[1], counts), roads=lanes, base=None, about=lambda *_: still,
        turns=SimpleNamespace(along=lambda s, edge, curvature, *_: curvature),
        split=SimpleNamespace(fold=lambda _: np.zeros(2, int)),
    )  # fmt: skip
    laid = (path, None, np.array([40.0, 10.0]), np.ones(2, bool))
    unit = TravelChannel._unit(cast(TravelChannel, channel), cast(Any, laid))
    assert unit.whole.tolist() == used


def test_nobody_knows_what_was_a_wait_where_the_log_does_not_say_how_long_a_truck_stood() -> None:
    """Two legs follow one another, and one that is not known, and a third: of the first and the third it is
    not known for how long the truck stood before; of the second it is."""

    def leg(begin: float, whole: bool) -> Drive:
        s = np.linspace(0.0, 12.0, 25)
        place = {"edge": np.zeros(25, np.int32), "edge_offset": begin + s, "x": begin + s}
        way = Motion.of(25, time=begin + s, speed=np.full(25, 1.0), **place)
        none = np.zeros(25, bool)
        return Drive(Leg(s, way, np.arange(25), 9.0, whole, {}), none, none, 9.0)

    drives = [leg(0.0, True), leg(12.0, True), leg(14.0, False), leg(26.0, True)]
    fleet = SimpleNamespace(network=network())
    route = SimpleNamespace(vehicle=0, day=0, start=0.0)
    laid = _lay_out(cast(Any, route), drives, cast(Any, fleet), make_stretches(network(), apart=True), 12.0)
    assert laid is not None
    path = laid[0]
    assert np.flatnonzero(path.held).tolist() == [0, 50]
    assert path.alone(path.of).tolist() == [False, True, False]


def test_waits_beside_a_border_of_two_stretches_are_those_of_one_place() -> None:
    """Trucks stop now before and now behind the border: every passage has one wait, on the stretch with more
    of them; and where one stop was for another truck, nobody knows what of the passage was a wait."""
    lanes = make_stretches(network(), apart=True)
    stops = np.zeros(len(lanes))
    stops[[1, 2]] = 4, 13
    places = Waits(lanes, stops, np.zeros((4, len(lanes))))
    assert places.place.tolist() == [2 if k == 1 else k for k in range(len(lanes))]
    at = np.linspace(0.1, 39.9, 400)
    for stop in (15.5, 16.5):
        node = int(np.searchsorted(at, stop))
        path = driven(at, np.arange(400) > 0, {node: 9.0})
        place = places.at(path)
        assert path.passages(place, places.size)[2][place == 2].sum() == 1.0
        assert path.alone(place).all()
        other = driven(at, np.arange(400) > 0, {}, held=int(np.searchsorted(at, 32.0 - stop)))
        assert not other.alone(place).any()


def test_numbers_of_one_term_are_tried_one_by_one_and_in_pairs() -> None:
    found = [tuple(k.parameter for k in h.knobs) for h in _numbers(all_terms()["laden_speed"], FLEET)]
    assert set(found) == {
        ("factor",), ("turns",), ("top",), ("factor", "turns"), ("factor", "top"), ("turns", "top"),
    }  # fmt: skip


def test_a_load_slows_a_truck_in_turns_by_the_share_that_is_said() -> None:
    term = all_terms()["laden_speed"]
    motion = Motion.of(
        3, payload=np.array([0.0, 900.0, 900.0]), speed=np.full(3, 3.0), curvature=np.array([0.5, 0.5, 0.0])
    )
    free = np.sqrt(TRUCK.drive.max_lateral_acceleration / 0.5)
    caps = term.function(motion, TRUCK, {"turns": 0.7})
    assert caps == pytest.approx([np.inf, 0.7 * free, 3.0])
    said = statement(term, [Parameter(n, 0.7, 0.6, 0.8, "1") for n in ("factor", "turns")], None, None)
    assert said == (
        "With a load, trucks drive at 70 % (60 % to 80 %) of their unladen speed; "
        "with a load, trucks take turns at 70 % (60 % to 80 %) of their unladen speed"
    )


@pytest.mark.parametrize(
    ("at", "near", "told"), [(0, 10.0, False), (4, 10.0, False), (2, 10.0, True), (0, 0.0, True)]
)
def test_what_is_near_a_junction_alone_is_no_stretch_of_road(at: int, near: float, told: bool) -> None:
    """Of five cells of 8 m one stands out; for waits (``near`` 0) it may be the first or last."""
    cells = make_stretches(network(), apart=True)
    moment = np.where(np.arange(len(cells)) == at, 10.0, 0.01)
    gain, first, last = _best(moment, np.eye(len(cells)), (-np.inf, np.inf), near, cells, 0, 5)
    assert ((first, last) == (at, at + 1)) is told
    assert (gain > 99.0) is told


@pytest.mark.parametrize(("alone", "told"), [(0.8, True), (1.2, False)])
def test_a_run_of_which_more_is_told_by_its_end_at_a_junction_is_no_stretch(alone: float, told: bool) -> None:
    """Ten seconds at 2 m/s lead over three cells, so the second cell seems to have a part of what the first
    has; a run has its own where it explains more than the ``alone`` that its first cell does."""
    cells = make_stretches(network(), apart=True)
    product = np.eye(len(cells)) + 0.5 * (np.eye(len(cells), k=1) + np.eye(len(cells), k=-1))
    moment = np.zeros(len(cells))
    # What two cells explain is (m0 + m1)^2 / 3; what the first alone does, m0^2.
    moment[0] = np.sqrt(alone)
    moment[1] = np.sqrt(3.0) - moment[0]
    moment[2] = -0.5
    gain, first, last = _best(moment, product, (-np.inf, np.inf), 10.0, cells, 0, 5)
    assert ((first, last) == (0, 2) and gain == pytest.approx(1.0)) is told


@pytest.mark.parametrize("reach", [0.2, 0.8])
def test_a_stretch_that_is_left_at_once_is_touched_by_nobody(reach: float) -> None:
    """Trucks that drive a share of a stretch and are on the next road then are on their way over a junction."""
    cells = make_stretches(network(), apart=True)
    x = np.arange(0.0, 8.0 * (2.0 + reach), 0.1)
    edge = np.zeros(len(x), np.int32)
    motion = Motion.of(len(x), x=x, y=0.0 * x, edge=edge, edge_offset=x, speed=np.ones(len(x)))
    unit = SimpleNamespace(
        own=SimpleNamespace(motion=motion, of=np.zeros(len(x), int)), whole=np.array([True])
    )
    channel = SimpleNamespace(_passes={}, cells=lambda _: cells, each=lambda work: iter([work([unit])]))
    passes = Channel.passes(cast(Channel, channel), None)
    assert passes.tolist() == [1, 1, int(reach > 0.5), *[0] * (len(cells) - 3)]


def test_how_a_turn_is_driven_does_not_hang_on_how_many_trucks_were_laden() -> None:
    """All ways are driven alike, at 2 m/s without and 1.2 m/s with a load, but not as often with it."""
    ways = []
    for k, laden in enumerate([1, 4, 8, 9]):
        for n in range(12):
            leg = crossing(1.5, lambda s, own=n < laden: 1.2 if own else 2.0)
            leg.path.edge[:] += 2 * k
            leg.path.payload[:] = 800.0 if n < laden else 0.0
            ways.append((leg, np.full(121, 3.5), np.ones(121, bool)))
    turns = measure(crossings(ways), TRUCK).by_way.values()
    assert [t.speed for t in turns] == pytest.approx([2.0] * 4)


@pytest.mark.parametrize(
    ("term", "large", "size", "beside"),
    [
        ("grade", {0: 0.02}, 1.0, True), ("grade", {0: 0.02, 4: 0.02}, 1.0, True),
        ("grade", {0: 0.02, 2: 0.02}, 0.05, False), ("grade", {0: 0.02, 2: 0.0075}, 0.05, True),
        ("grade", {0: 0.02, 2: 0.0075}, 1.0, False),  # what is elsewhere counts alone
        ("grade", {0: 0.02, 1: 0.02}, 0.05, False), ("waiting", {0: 1.0}, 0.05, False),
    ],
)  # fmt: skip
def test_a_field_beside_junctions_alone_is_none(
    term: str, large: dict[int, float], size: float, beside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of five cells of 8 m some stand out; waits often are where roads meet."""
    monkeypatch.setattr(finish, "size_of", lambda *_: SimpleNamespace(verified=size))
    stretches = make_stretches(network(), apart=True)
    deviation = np.full(len(stretches), 0.003)
    deviation[list(large)] = list(large.values())
    passes = np.arange(len(stretches)) < 5
    channel = SimpleNamespace(cells=lambda _: stretches, passes=lambda _: passes, place_error=0.04)
    joint = cast(Joint, SimpleNamespace(
        chosen=[Hypothesis(term, field=True)], model=SimpleNamespace(fields={term: deviation})
    ))  # fmt: skip
    problem = cast(Problem, SimpleNamespace(channel=channel))
    assert finish.at_junctions(problem, joint, joint) is beside


def test_a_step_is_taken_once_more_where_the_model_that_it_found_shows_less_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of two names that noise hides the simpler goes first; the noise about it parts them, and no others."""
    names, far = [Hypothesis("thermal_load"), Hypothesis("auxiliary_load")], Hypothesis("grade", field=True)

    def joint(chosen: Sequence[Hypothesis]) -> Joint:
        score = 1.0 if names[1] in chosen else 2.0
        return cast(Joint, SimpleNamespace(chosen=tuple(chosen), model=None, losses=np.zeros(1), score=score))

    class Noisy:
        settings, noisy, rest = SimpleNamespace(most_findings=1), True, (*names, far)

        def learn_anew(self, *_: object) -> bool:
            was, self.noisy = self.noisy, False
            return was

    def step(problem: Noisy, found: Search, rest: tuple[Hypothesis, ...]) -> tuple[Joint, Joint]:
        assert rest == (problem.rest if problem.noisy else tuple(names))
        found.near = tuple(names)
        return found.joint, joint([*found.joint.chosen, names[0 if problem.noisy else 1]])

    monkeypatch.setattr(forward, "_step", step)
    monkeypatch.setattr(forward, "refit", lambda problem, model, chosen: joint(chosen))
    monkeypatch.setattr(finish, "two_for_one", lambda *_, **__: None)
    for last in ("pruned", "shaped"):
        monkeypatch.setattr(forward, last, lambda problem, found: found)
    found = forward.search(cast(Problem, Noisy()), cast(Model, None))
    assert found.joint.chosen == (names[1],)


@dataclass(frozen=True)
class Fit:
    """As much of a joint fit as scores need."""

    chosen: tuple[Hypothesis, ...]
    score: float
    losses: np.ndarray
    model: None = None


def test_a_curve_that_hours_confirm_less_predicts_no_better_than_before() -> None:
    """Its losses rise as its score does: what is validated in one way is not compared with the other."""
    curve = Hypothesis(curve=FreeCurve("power", ("time",), ((0.0, 1.0),)))
    now, fit = Fit((), 100.0, np.full(4, 25.0)), Fit((curve,), 20.0, np.full(4, 2.0))
    unseen = {curve.kind: Screened(curve, 70.0, np.full(4, 24.0))}
    problem, sums = cast(Problem, None), cast(Sums, None)
    less = forward._no_better_than(problem, sums, cast(Joint, now), cast(Joint, fit), [], unseen)
    assert less.score == 30.0
    assert less.losses.sum() - fit.losses.sum() == pytest.approx(less.score - fit.score)


def test_an_error_far_above_its_noise_is_not_none_where_few_trips_show_it() -> None:
    """What is left may be chance, or not: nobody can say that nothing is missing."""
    channel = SimpleNamespace(gathers=SETTINGS.gathers, plain_error=SETTINGS.model_error)
    task = cast(explain.Task, SimpleNamespace(problem=SimpleNamespace(settings=SETTINGS, channel=channel)))
    reason = explain._hidden(task, ChannelFit("battery_power", "", 0.47, 0.47, 0.03))
    assert reason is not None and "record more" in reason and "47 %" in reason


def test_a_slow_number_that_hours_confirm_more_loses_no_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trips and hours are other folds: what is between them is one number, and never speaks for a fit."""
    knob = Hypothesis("thermal_load", (Knob("thermal_load", "cooling", FLEET),), (("threshold", 4.0),))
    now, fit = Fit((), 100.0, np.full(4, 25.0)), Fit((knob,), 20.0, np.full(4, 2.0))
    problem, sums = cast(Problem, None), cast(Sums, None)
    for hours, more in ((90.0, 0.0), (70.0, 5.0)):
        trips = Screened(knob, 75.0, np.array([900.0, -850.0, 0.0, 25.0]))
        monkeypatch.setattr(forward, "gained", lambda *_, trips=trips: [trips])
        unseen = {knob.kind: Screened(knob, hours, np.full(4, hours / 4.0))}
        less = forward._no_better_than(problem, sums, cast(Joint, now), cast(Joint, fit), [], unseen)
        assert less.score == 20.0 + more
        assert less.losses == pytest.approx(np.full(4, 2.0 + more / 4.0))


def test_a_place_that_nobody_passes_later_is_told_without_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A field of a part of the time is one of all of it, unless passes at other times speak against that."""
    part = Hypothesis("surface_resistance", field=True, when=Scope(until=60.0))
    always = replace(part, when=FLEET)
    sums = SimpleNamespace(settings=SETTINGS, sums=lambda *_: None)
    monkeypatch.setattr(forward, "stood_out", lambda *_: [part])
    for nothing in ("pattern_hypotheses", "screen"):
        monkeypatch.setattr(forward, nothing, lambda *_: [])
    monkeypatch.setattr(forward, "_best", lambda *_: Fit((part,), 20.0, np.zeros(1)))
    # Where trips disagree on the time, it is told without one, or not at all if nothing speaks for that.
    cases = (
        (100.0, 1.0, True, always),
        (100.0, 9.0, True, part),
        (100.0, 9.0, False, always),
        (30.0, 9.0, False, None),
    )
    for score, apart, agree, best in cases:
        now, fit = Fit((), score, np.zeros(1)), partial(Fit, score=20.0 + apart, losses=np.zeros(1))
        monkeypatch.setattr(forward, "trips_agree", lambda *_, agree=agree: agree)
        monkeypatch.setattr(forward, "scored", lambda *_, now=now: now)
        monkeypatch.setattr(forward, "refit", lambda _, __, chosen, *___, fit=fit: fit(tuple(chosen)))
        found = cast(Search, SimpleNamespace(rivals={part.kind: []}))
        now_too = cast(Joint, SimpleNamespace(model=None, chosen=()))
        better = forward._at_times(cast(Problem, sums), now_too, found)
        assert (better and better.chosen) == (best and (best,))
        assert best is None or best.kind in found.rivals


def test_how_well_a_number_is_known_does_not_hang_on_its_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    """An ohm may have as many watts as it likes: neither is known the better for the other."""
    h, knobs = (
        Hypothesis("viscous_drag"),
        [Knob("battery_resistance", "resistance"), Knob("auxiliary_load", "power")],
    )
    known = []
    for unit in (1.0, 1e-9):
        scale = np.array([1.0, unit])
        gram = np.outer(scale, scale) * np.array([[4.0, 1.0], [1.0, 9.0]])
        monkeypatch.setattr(joint_fit, "_products", lambda *_, gram=gram: (gram, gram, np.zeros(2)))
        atoms = [
            Atom(np.array([i]), np.ones(1), 1e-6 * s**2, knob=k, owner=h)
            for i, (k, s) in enumerate(zip(knobs, scale, strict=True))
        ]
        fit = SimpleNamespace(
            design=Design(tuple(atoms)), fitted=SimpleNamespace(beta=np.zeros(2)), chosen=()
        )
        problem = cast(Problem, SimpleNamespace(settings=SETTINGS))
        known.append(joint_fit.errors(joint_fit.covariance(problem, cast(Joint, fit))[0]) * scale)
    assert known[0] == pytest.approx(known[1], rel=1e-6)


def test_what_a_place_is_off_by_moves_shapes_that_share_it_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two shapes of nearly the same stretches are hardly told apart; an error of the place is shared by both."""
    shapes = tuple(Pattern(np.array(w).tobytes(), "") for w in ([1.0, 1.0, 0.0], [1.0, 1.0, 1e-3]))
    h = Hypothesis("grade", patterns=shapes)
    gram = np.array([[4.0, 4.0 - 1e-6], [4.0 - 1e-6, 4.0]])
    shift = np.array([0.4, 0.4])
    monkeypatch.setattr(joint_fit, "_products", lambda *_: (gram, np.zeros((2, 2)), shift))
    atoms = tuple(Atom(np.array([i]), np.ones(1), 1e-9, owner=h) for i in range(2))
    fit = SimpleNamespace(design=Design(atoms), fitted=SimpleNamespace(beta=np.zeros(2)), chosen=(h,))
    problem = cast(Problem, SimpleNamespace(settings=replace(SETTINGS, widening=0.0)))
    field, known = np.stack([p.weights for p in shapes]), joint_fit.covariance(problem, cast(Joint, fit))[0]
    assert np.all(joint_fit.errors(field.T @ known @ field) < 0.4 / 4.0 * 2.0)


def test_a_field_takes_the_place_of_its_shapes() -> None:
    """One term is told once of all places: more roads go with those found, and a field holds them all."""
    one, two = (Pattern(np.eye(3)[i].tobytes(), f"r{i}") for i in range(2))
    road, drag = Hypothesis("grade", patterns=(one,)), Hypothesis("aerodynamic_drag", (Knob("x", "y"),))
    more, field = replace(road, patterns=(two,)), Hypothesis("grade", field=True)
    assert forward._whole(more, (road, drag)) == (replace(road, patterns=(one, two)), (drag,))
    assert forward._whole(field, (road, drag)) == (field, (drag,))
    assert forward._whole(Hypothesis("surface_resistance", field=True), (road, drag))[1] == (road, drag)
    assert forward._whole(Hypothesis(field=True), (road, drag))[1] == (road, drag)


def test_shapes_are_compared_whatever_the_step_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sums of a step that looks at few hypotheses lack the other shapes of a number: they are summed."""
    knob = Knob("enabled_load", "power")
    shapes = [Hypothesis("enabled_load", (knob,), (("hold", hold),)) for hold in (2.0, 4.0, 8.0)]
    assert len({h.alike for h in shapes}) == 1
    few, every = (SimpleNamespace(layout=Layout(tuple(s for h in hs for s in h.sources), (0,)))
                  for hs in (shapes[:1], shapes))  # fmt: skip

    class Shaped:
        rest = tuple(shapes)

        def layout(self, asked: Sequence[Hypothesis]) -> Layout:
            return Layout(tuple(s for h in asked for s in h.sources), (0,))

        def sums(self, *_: object) -> SimpleNamespace:
            return every

    def scored(problem: object, sums: SimpleNamespace, model: object, chosen: Sequence[Hypothesis]) -> object:
        assert sums.layout.holds(Shaped().layout(chosen))
        return SimpleNamespace(chosen=tuple(chosen), score=abs(dict(chosen[0].setting)["hold"] - 4.0))

    monkeypatch.setattr(finish, "scored", scored)
    problem, model = cast(Problem, Shaped()), cast(Model, None)
    assert finish.formed(problem, cast(Sums, few), model, (shapes[0],), shapes[0]) == (shapes[1],)


def test_a_tolerance_on_its_edge_hides_no_less_than_inside(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number found is known as well as the number of the truck file beside it lets it be, wherever that is."""
    found, own = Knob("viscous_drag", "coefficient"), Knob("rolling_resistance", "coefficient")
    h = Hypothesis("viscous_drag", (found,))
    gram = 100.0 * np.array([[1.0, 0.99], [0.99, 1.0]])
    monkeypatch.setattr(joint_fit, "_products", lambda *_: (gram, gram, np.zeros(2)))
    problem = cast(Problem, SimpleNamespace(settings=SETTINGS))

    def error(tolerance: float, at: float) -> float:
        edge = Atom(np.array([1]), np.ones(1), 4.0 / tolerance**2, low=-tolerance, high=tolerance, knob=own)
        free = Atom(np.array([0]), np.ones(1), 1e-6, knob=found, owner=h)
        fitted = SimpleNamespace(beta=np.array([1.0, at]))
        fit = cast(Joint, SimpleNamespace(design=Design((free, edge)), fitted=fitted, chosen=()))
        return float(joint_fit.errors(joint_fit.covariance(problem, fit)[0])[0])

    assert error(0.5, 0.5) == error(0.5, 0.1)
    assert error(0.5, 0.5) > 2.0 * error(0.01, 0.01)


def test_what_a_number_spares_tolerances_speaks_for_it() -> None:
    """Unseen trips confirm nothing of a number that tolerances say as well; that they need not, they do."""
    unit = SimpleNamespace(
        windows=SimpleNamespace(vehicle=np.zeros(4, int), time=np.arange(4.0)), whole=np.ones(4, bool),
        recorded=np.full(4, 10.0), level=np.full(4, 10.0),
    )  # fmt: skip
    problem = cast(Problem, SimpleNamespace(
        noise=SimpleNamespace(design=1.0, weight=lambda u: np.ones(4)), settings=SETTINGS, price=lambda h: 7.0,
        training=lambda: [unit], channel=None,
    ))  # fmt: skip
    h = Hypothesis("viscous_drag", (Knob("viscous_drag", "coefficient"),))

    def verified(score: float) -> float:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(joint_fit, "said", lambda channel, unit, joint: (np.ones(4), None))
            model, rest = cast(Model, SimpleNamespace(without=lambda *_: None)), cast(Any, None)
            now, joint = (Joint(model, (h,), np.zeros(1), s, 1.0, rest, rest) for s in (0.0, score))
            return joint_fit.size_of(problem, now, joint).verified

    assert verified(7.0) == 0.0
    assert verified(-5.0) == pytest.approx(np.sqrt(2.0 * 12.0 / 400.0))


def test_a_stretch_gains_no_more_than_a_plausible_value_of_it() -> None:
    cells = make_stretches(network())
    moment = np.where(np.arange(len(cells)) == 2, -10.0, 1.0)
    gain, first, last = _best(moment, np.eye(len(cells)), (-0.05, 19.0), 0.0, cells, 0, 5)
    assert not first <= 2 < last
    assert gain == pytest.approx(2.0)


def test_what_lies_beside_a_junction_alone_is_no_place_of_a_field_that_lies_elsewhere_too() -> None:
    """Of a road of five stretches the third and the fifth stand out; if only the fifth does, it is the place."""
    cells, seen = make_stretches(network(), apart=True), np.full(20, 10)
    for large, named in (([2, 4], [(2, 2)]), ([4], [(4, 4)]), ([3, 4], [(3, 4)])):
        deviation = np.where(np.isin(np.arange(20), large), 1.5, 0.0)
        values = Values(deviation, seen, np.eye(20), *[1e-4 * np.eye(20)] * 2)
        where, _ = told(cells, values, Hypothesis("surface_resistance", field=True))
        assert where is not None
        assert [(r["from"], r["to"]) for r in where["edges"]] == [
            (cells.start[a], cells.end[b]) for a, b in named
        ]


def test_free_places_stand_out_by_one_or_by_neighbours_together_or_not_at_all() -> None:
    """Errors of 100 W: 300 W on one stretch are told, 150 W on five in a row, and 150 W here and there are not."""
    cells = make_stretches(network())
    for at, watts, out in (([2], 300.0, True), ([2, 3, 4, 5, 6], 150.0, True), ([0, 4, 12], 150.0, False)):
        field = np.where(np.isin(np.arange(len(cells)), at), watts, 0.0)
        values = Values(
            field, np.full(len(cells), 10), np.eye(len(cells)), *[100.0**2 * np.eye(len(cells))] * 2
        )
        assert together(cells, values).any() == out


def test_what_has_no_name_still_has_its_place() -> None:
    """Of a road of five stretches two need 900 and 1100 W more than any term says."""
    cells = make_stretches(network())
    watts = np.where(np.arange(len(cells)) == 1, 900.0, 0.0) + np.where(
        np.arange(len(cells)) == 2, 1100.0, 0.0
    )
    seen = np.full(len(cells), 10)
    values = Values(watts, seen, np.eye(len(cells)), *[100.0 * np.eye(len(cells))] * 2)
    where, numbers = told(cells, values, Hypothesis(field=True))
    assert where is not None and numbers == []
    (row,) = where["edges"]
    assert (row["from"], row["to"]) == (cells.start[1], cells.end[2])
    assert row["low"] < row["value"] < row["high"] and row["value"] == pytest.approx(1000.0)
    ends = cells.network.position(cells.road_edge[[1, 2]], np.array([cells.start[1], cells.end[2]]))[:, :2]
    assert where["extent"] == pytest.approx([*ends.min(axis=0), *ends.max(axis=0)])


@pytest.mark.parametrize(("off", "told"), [([0.0, 1.2], [1]), ([1.5, 1.5], [None]), ([0.5, -0.5], [])])
def test_what_tolerances_move_together_is_told_of_all_and_of_one_truck(off: list[float], told: list) -> None:
    """Two trucks, of which four numbers each may be off by 2 %, and four of both: they are off by so many
    times as much, all the same way. Chance moves four of them by 4 % together, of one truck in two by 5 %."""
    fleet = [Knob("mass", str(k)) for k in range(4)]
    own = [replace(k, scope=Scope((v,))) for v in range(2) for k in fleet]
    limits = {"precision": 1.0, "low": -0.02, "high": 0.02}
    atoms = [
        Atom(np.array([j]), np.ones(1), **limits, vehicle=k.scope.one, knob=k)
        for j, k in enumerate(fleet + own)
    ]
    both = min(off) if min(off) > 0.0 else 0.0
    beta = 0.02 * np.repeat([both, off[0] - both, off[1] - both], 4)
    units = [
        SimpleNamespace(key=(v, 0.0), whole=np.ones(5, bool), windows=SimpleNamespace(vehicle=np.full(5, v)))
        for v in range(2)
    ]
    channel = SimpleNamespace(
        fleet=SimpleNamespace(vehicles=("T1", "T2")),
        columns=lambda *_: (np.ones(5), np.ones((5, 12), np.float32)),
    )
    problem = SimpleNamespace(
        channel=channel, layout=lambda _: SimpleNamespace(sources=[]), training=lambda: iter(units)
    )
    fit = SimpleNamespace(
        design=Design(tuple(atoms)), model=None, chosen=(), fitted=SimpleNamespace(beta=beta)
    )
    assert list(joint_fit.strain(cast(Any, problem), cast(Any, fit))) == told
