"""Laws that the parts of the diagnosis keep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.core.motion import Motion
from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.trajectory import Labels, Trajectory
from fleetlog.core.truck import Chassis, Truck
from fleetlog.discovery import linear, replay, splits, windows
from fleetlog.discovery.bends import bends
from fleetlog.discovery.candidates import knobs
from fleetlog.discovery.evaluate import Evaluation
from fleetlog.discovery.fleet import Fleet
from fleetlog.discovery.model import Found
from fleetlog.discovery.replay import Block, blocks
from fleetlog.discovery.sensors import clock_offset
from fleetlog.discovery.smooth import Akima, gaussian
from fleetlog.discovery.squares import make_squares
from fleetlog.discovery.stretches import along, make_stretches
from fleetlog.physics.power import Physics, all_terms, battery_power

TRUCK = Truck(Chassis(4500.0))


def network(angle: float = np.pi / 2):
    """Two roads of 40 m that meet at an angle, both ways."""
    turn = np.array([np.cos(angle), np.sin(angle), 0.0])
    a = Edge("a", "n0", "n1", np.array([[0.0, 0, 0], [40.0, 0, 0]]), "a", 3.0)
    b = Edge("b", "n1", "n2", np.array([[40.0, 0, 0], np.array([40.0, 0, 0]) + 40.0 * turn]), "b", 3.0)
    return build_network([a, reversed_edge(a), b, reversed_edge(b)])


@given(st.floats(-2.2, 2.2))
@settings(max_examples=40, deadline=None)
def test_a_corner_is_turned_by_its_angle_however_it_is_rounded(angle: float) -> None:
    net = network(angle)
    path = bends(net, np.array([net.edge("a"), net.edge("b")], np.int32), 2.5)
    assert np.sum(path.curvature * path.metres) * 0.5 == pytest.approx(angle, abs=0.06)


def test_a_corner_turned_at_a_standstill_is_no_bend() -> None:
    net = network()
    edges = np.array([net.edge("a"), net.edge("b")], np.int32)
    assert np.abs(bends(net, edges, 2.5, np.array([False, True])).curvature).max() == 0.0


def drive(seconds: int = 600, seed: int = 0) -> Trajectory:
    """A truck that sets off and stops every half minute, its power that of the nominal model."""
    rng = np.random.default_rng(seed)
    t = np.arange(seconds, dtype=float)
    speed = np.clip(np.minimum((t % 30) * 0.6, (30 - t % 30) * 0.7), 0, rng.uniform(2.5, 3.5))
    s = np.cumsum(speed)
    columns = {"x": s, "y": np.zeros(seconds), "heading": np.zeros(seconds), "speed": speed, "payload": np.full(seconds, 500.0),
               "trip_id": (t // 30).astype(np.int64)}  # fmt: skip
    track = Trajectory("T", (t * 1e6).astype(np.int64), columns)
    (block,) = blocks(track, 0, None, 2.5)
    return track.with_columns(battery_power=block.rows(battery_power(block.motion, Physics(TRUCK))))


def test_windows_keep_the_energy_and_never_straddle_a_trip() -> None:
    (block,) = blocks(drive(), 0, None, 2.5)
    cut = windows.cut(block, 10.0)
    power = battery_power(block.motion, Physics(TRUCK))
    assert cut.energy(block, power).sum() == pytest.approx((power * block.motion.dt).sum() * 1e-3)
    for w in range(cut.count):
        assert len(np.unique(block.trip[cut.of_row == w])) == 1


@given(st.floats(-8.0, 8.0).filter(lambda s: abs(s) > 1.0))
@settings(max_examples=8, deadline=None)
def test_a_late_clock_is_found(shift: float) -> None:
    days = []
    for k in range(2):
        track = drive(900, k)
        t = track.seconds()
        late = np.interp(t - shift, t, track.floats("battery_power"))
        days.append((k, track.with_columns(battery_power=late)))
    fault = clock_offset(Fleet(days, ("a", "b"), None, TRUCK, {}, {}))
    assert fault is not None
    assert fault.value == pytest.approx(shift, abs=0.15)


def test_a_right_clock_is_no_fault() -> None:
    fleet = Fleet([(0, drive(900, 0)), (1, drive(900, 1))], ("a", "b"), None, TRUCK, {}, {})
    assert clock_offset(fleet) is None


@pytest.mark.parametrize(
    "name",
    [
        "rolling_resistance",
        "grade",
        "thermal_load",
        "payload",
        "drivetrain_efficiency",
        "cornering_resistance",
    ],
)
def test_a_changed_term_is_the_difference_of_two_sums(name: str) -> None:
    """The short cut of one term must agree with the whole sum evaluated twice."""
    rng = np.random.default_rng(1)
    motion = Motion.of(200, speed=rng.uniform(0, 4, 200), acceleration=rng.normal(0, 0.5, 200), payload=800.0,
                       curvature=rng.normal(0, 0.1, 200), ambient_temperature=5.0)  # fmt: skip
    same = (motion.speed, motion.acceleration)
    block = Block(motion, 1, motion.time, motion.power, motion.soc, motion.trip, 0, 0, same)
    found = Found(TRUCK).with_value("auxiliary_load", "power", 700.0)
    term = all_terms()[name]
    parameter = term.parameters[0]
    value = 0.5 * (parameter.low + parameter.high)
    e = Evaluation(block, found, None, "battery_power")
    after = found.with_value(name, parameter.name, value).physics(motion, None)
    expected = battery_power(motion, after) - battery_power(motion, found.physics(motion, None))
    assert e.change(term, {parameter.name: value}) == pytest.approx(expected, abs=1e-6)


def test_an_odd_field_has_opposite_values_in_the_two_directions() -> None:
    net = network()
    cells = make_stretches(net)
    field = np.random.default_rng(0).normal(size=len(cells))
    there = Motion.of(1, edge=net.edge("a"), edge_offset=11.0)
    back = Motion.of(1, edge=net.edge("-a"), edge_offset=29.0)
    assert along(cells, there, field, True)[0] == pytest.approx(-along(cells, back, field, True)[0])
    assert along(cells, there, field, False)[0] == pytest.approx(along(cells, back, field, False)[0])


def test_squares_hold_a_vector_for_an_odd_field() -> None:
    rng = np.random.default_rng(0)
    squares = make_squares(rng.uniform(0, 60, 500), rng.uniform(0, 60, 500))
    assert squares is not None
    values = np.tile([0.03, 0.0], len(squares))
    east, north, west = (
        along(squares, Motion.of(1, x=30.0, y=30.0, heading=h), values, True)[0]
        for h in (0.0, np.pi / 2, np.pi)
    )
    assert (east, north, west) == pytest.approx((0.03, 0.0, -0.03), abs=1e-12)


def test_grams_of_folds_add_up_and_boxes_hold() -> None:
    rng = np.random.default_rng(0)
    n = 400
    x, z = rng.normal(size=(n, 2)).astype(np.float32), rng.normal(size=(n, 1)).astype(np.float32)
    y = 5.0 * z[:, 0] + x @ np.array([1.0, -2.0]) + 0.1 * rng.normal(size=n)
    w = windows.Windows(
        *(np.arange(n) // 10 for _ in range(3)),
        np.zeros(n, int),
        np.full(n, 10.0),
        np.full(n, 20.0),
        *(np.zeros(n) for _ in range(2)),
        np.arange(n, dtype=float),
    )
    fold = {"trip": np.arange(n) // 10 % 5}
    p = linear.pose(
        w,
        y,
        y,
        {"g": x},
        {"small": z},
        {"small": np.array([0.1])},
        np.ones(n, bool),
        fold,
        w.trip,
        np.zeros(n),
        np.zeros(n),
        np.ones(n),
    )
    assert sum(f[0] for f in p.folds("trip")) == pytest.approx(p.gram, rel=1e-4)
    f = linear.fit(p, linear.Selection().add("g", p.at["g"], 1e6))
    assert f.beta[0] == pytest.approx(0.2)  # at the wall of its box: twice its spread
    assert f.beta[1:] == pytest.approx([1.0, -2.0], abs=0.8)


def test_nothing_is_held_out_by_rows() -> None:
    w = windows.join([windows.describe(b, windows.cut(b, 10.0)) for b in blocks(drive(1800), 0, None, 2.5)])
    test = splits.test_windows(w, "trips", np.random.default_rng(0))
    assert 0.1 < test.mean() < 0.35
    assert not set(w.trip[test]) & set(w.trip[~test])


def test_every_term_with_numbers_can_be_turned() -> None:
    for term in all_terms().values():
        if term.parameters and not term.field:
            assert len(knobs(term)) >= 1
            assert all(k.parameter in term.by_name for k in knobs(term))


def test_labels_of_unknown_edges_are_off_the_map() -> None:
    track = drive(100).with_columns(
        edge_id=Labels.of(["a"] * 50 + ["nowhere"] * 50), edge_offset=np.linspace(0, 40, 100)
    )
    (block,) = blocks(track, 0, network(), 2.5)
    assert set(np.unique(block.motion.edge)) == {-1, network().edge("a")}


@given(st.integers(5, 60), st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_akima_agrees_with_the_reference(n: int, seed: int) -> None:
    from scipy.interpolate import Akima1DInterpolator

    rng = np.random.default_rng(seed)
    x, y = np.cumsum(rng.uniform(0.2, 2.0, n)), np.round(rng.normal(size=n) * rng.integers(0, 2, n), 1)
    at = rng.uniform(x[0], x[-1], 200)
    reference = Akima1DInterpolator(x, y)
    value, slope = Akima(x, y).with_slope(at)
    assert value == pytest.approx(reference(at), abs=1e-9)
    assert slope == pytest.approx(reference(at, nu=1), abs=1e-8)


def test_the_gaussian_agrees_with_the_reference() -> None:
    from scipy.ndimage import gaussian_filter1d

    values = np.random.default_rng(0).normal(size=300)
    assert gaussian(values, 1.7) == pytest.approx(gaussian_filter1d(values, 1.7), abs=1e-12)


def test_a_kink_between_two_rows_is_found_where_the_lines_meet() -> None:
    time = np.arange(0.0, 12.0)
    true = np.where(time < 5.3, 3.0, np.maximum(3.0 - 0.8 * (time - 5.3), 0.5))
    fine = np.arange(0.125, 11.0, 0.25)
    speed, acceleration = replay._smooth_speed(time, true, fine)
    v, a = replay._kinked_speed(time, true, fine, speed, acceleration)
    exact = np.where(fine < 5.3, 3.0, np.maximum(3.0 - 0.8 * (fine - 5.3), 0.5))
    near = np.abs(fine - 5.3) < 2.0
    assert np.abs(v - exact)[near].max() < 1e-9 < np.abs(speed - exact)[near].max()
    assert set(np.round(a[near & (np.abs(fine - 5.3) > 0.25)], 9)) == {0.0, -0.8}
