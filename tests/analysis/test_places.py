"""Places where trucks stand again and again: wherever the origin lies, and whatever the hour is."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage

from fleetlog.analysis.stops import stops
from fleetlog.core.site import Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.simulate.places import CLOSE, REACH, Stands, clusters, find_stands, joined
from fleetlog.store import Dataset, DatasetWriter
from fleetlog.store.trips import trip_ids

from .conftest import T0

DAY = 86_400_000_000


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two labels part the same sets."""
    return len({*zip(a.tolist(), b.tolist(), strict=True)}) == len({*a.tolist()}) == len({*b.tolist()})


def stands_at(xy: np.ndarray, change: float = 0.0) -> Stands:
    zero = np.zeros(len(xy))
    start = np.arange(len(xy)) * 100_000_000
    return Stands(zero.astype(int), start, start + 20_000_000, *xy.T, zero, zero + change, *[zero] * 4)


@pytest.mark.parametrize("kind", ["scattered", "lattice", "line", "repeated", "far apart"])
@given(seed=st.integers(0, 10_000), spread=st.sampled_from([1.0, 5.0, 30.0]))
def test_points_are_joined_as_by_single_linkage(kind: str, seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 120))
    points = rng.normal(0.0, spread, (n, 2))
    if kind == "lattice":
        points = np.round(points / REACH) * REACH
    elif kind == "line":
        points[:, 1] = 7.0
    elif kind == "repeated":
        points = points[rng.integers(0, n, n)] + 1e5
    elif kind == "far apart":
        points = np.concatenate([points + 5e4 * k for k in (-1, 0, 1)])
    points = np.repeat(points, int(rng.choice([1, 40])), axis=0)
    within = fcluster(linkage(points, "single"), REACH * (1.0 + 1e-9), "distance")
    assert same(joined(points), within)


@given(
    st.integers(0, 10_000),
    st.floats(-1e3, 1e3),
    st.floats(-1e3, 1e3),
    st.floats(0.0, 6.28),
    st.integers(2, 8),
)
def test_places_move_and_turn_with_the_site(
    seed: int, dx: float, dy: float, turn: float, visits: int
) -> None:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0.0, 60.0, (8, 2))
    xy = middle[rng.integers(0, 8, 60)] + rng.normal(0.0, 0.5, (60, 2))
    c, s = np.cos(turn), np.sin(turn)
    other = xy @ np.array([[c, s], [-s, c]]) + (dx, dy)
    one, two = (clusters(stands_at(at), visits) for at in (xy, other))
    assert same(one, two) and ((one < 0) == (two < 0)).all()
    one, two = (clusters(stands_at(at, 500.0), visits, loads=True) for at in (xy, other))
    assert same(one, two) and (one >= 0).all()


@pytest.mark.parametrize("origin", [(0.0, 0.0), (0.7, 0.7), (1.0, 1.0), (1000.37, -700.61)])
def test_a_place_may_lie_anywhere(origin: tuple[float, float]) -> None:
    spots = np.repeat([[20.0, 0.0], [180.0, 60.0]], 4, axis=0) + origin
    xy = spots + np.random.default_rng(0).normal(0.0, 0.2, (8, 2))
    assert clusters(stands_at(xy)).tolist() == [0, 0, 0, 0, 1, 1, 1, 1]


def test_a_lone_stand_between_two_places_does_not_join_them() -> None:
    near = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    gap = 1.2 * REACH
    xy = np.concatenate([near, near + (gap + 0.1, 0.0), [[0.5 * gap, 0.0]]])
    assert 0.5 * gap > CLOSE
    assert clusters(stands_at(xy))[:6].tolist() == [0, 0, 0, 1, 1, 1]


def shuttle(begin: int) -> Trajectory:
    """Between two places 60 m apart, 30 s each way, in which it stands for 60 s and takes up or sets down."""
    t = np.arange(1800)
    turn, phase = np.divmod(t, 90)
    way = np.clip((phase - 60) * 2.0, 0.0, 60.0)
    x = np.where(turn % 2 == 0, way, 60.0 - way)
    load = 800.0 * ((turn % 2 == 0) == (phase >= 40))
    columns = {"x": x, "y": 0.0 * x, "heading": 0.0 * x, "speed": 2.0 * (phase >= 60), "payload": load}
    out = Trajectory("T1", begin + t * 1_000_000, {**columns, "soc": 0.9 - 1e-5 * t})
    return out.with_columns(trip_id=trip_ids(out))


@pytest.mark.parametrize("second", [905, 930, 939, 940, 941, 957])
def test_a_truck_that_stands_at_midnight_stands_once(tmp_path: Path, second: int) -> None:
    """A day ends so many seconds after the begin: as it stands, lifts, or is about to set off."""
    found = []
    midnight = T0 // DAY * DAY + DAY
    for name, begin in (("noon", T0), ("midnight", midnight - second * 1_000_000)):
        with DatasetWriter.create(tmp_path / name, "recorded", Site("s")) as w:
            w.write(shuttle(begin))
        d = Dataset(tmp_path / name)
        stands = find_stands(d)
        found.append(np.array(astuple(stands), dtype=float))
        found[-1][1:3] -= begin
        assert stops(d).summary["loads_carried"] == 10
    assert len(d.dates) == 2
    np.testing.assert_allclose(found[0], found[1], atol=3e-5)


def test_a_truck_that_never_drives_may_tell_its_load(tmp_path: Path) -> None:
    t, zero = T0 + np.arange(600) * 1_000_000, np.zeros(600)
    still = {"x": zero, "y": zero, "heading": zero, "speed": zero}
    lines = []
    for name, columns in (("weighed", {**still, "payload": zero}), ("not", still)):
        truck = Trajectory("T1", t, columns)
        with DatasetWriter.create(tmp_path / name, "recorded", Site("s")) as w:
            w.write(truck.with_columns(trip_id=trip_ids(truck)))
        lines.append(stops(Dataset(tmp_path / name)).lines[1])
    assert lines[0].startswith("0 loads went") and "no payload" in lines[1]
