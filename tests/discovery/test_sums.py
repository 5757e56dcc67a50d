"""All that a fit needs of windows are sums, and sums of days add up."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.discovery import linear
from fleetlog.discovery.windows import Windows

W = 600


def problem(rows: np.ndarray, x: np.ndarray, y: np.ndarray) -> linear.Problem:
    """The problem of some of the windows: two days of thirty trips each."""
    n = np.arange(W)
    w = Windows(
        n // 10,
        np.zeros(W, int),
        n // 300,
        np.zeros(W, int),
        np.full(W, 10.0),
        np.full(W, 20.0),
        n * 1.0,
        n * 1.0,
        n * 1.0,
    )
    return linear.pose(
        w, y, y, {"g": x}, {"small": np.ones((W, 1), np.float32)}, {"small": np.array([0.1])}, rows,
        {"trip": n // 10 % 5}, n // 100, np.zeros(W), np.zeros(W), np.linspace(0.5, 2.0, W),
    )  # fmt: skip


@pytest.fixture
def data() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x = rng.normal(size=(W, 4)).astype(np.float32)
    return x, x @ np.array([1.0, -2.0, 0.0, 0.5]) + 0.1 * rng.normal(size=W)


def test_two_days_add_up_to_both(data) -> None:
    first = np.arange(W) < 300
    a, b, both = (problem(rows, *data) for rows in (first, ~first, np.ones(W, bool)))
    assert a.gram + b.gram == pytest.approx(both.gram, rel=1e-5, abs=1e-2)
    assert a.moment + b.moment == pytest.approx(both.moment, rel=1e-5, abs=1e-2)
    s = linear.Selection().add("g", both.at["g"], 10.0)
    yy, n = float(b.y @ b.y), len(b.y)
    # Of both without the second day the first is left; with its sums the first is both.
    left = linear.fit(both, s, (b.gram, b.moment, yy, n))
    assert left.beta == pytest.approx(linear.fit(a, s).beta, rel=1e-4, abs=1e-5)
    of_sums = linear.fit(a, s, (-b.gram, -b.moment, -yy, -n))
    assert of_sums.beta == pytest.approx(linear.fit(both, s).beta, rel=1e-4, abs=1e-5)


def test_sums_of_more_columns_are_those_of_all_columns(data) -> None:
    x, y = data
    every = np.ones(W, bool)
    p = problem(every, x[:, :2], y).extended({"more": x[:, 2:]})
    whole = problem(every, x, y)
    for (gram, moment, square, count), (g, m, s, c) in zip(p.folds("trip"), whole.folds("trip"), strict=True):
        assert gram == pytest.approx(g, rel=1e-5, abs=1e-2)
        assert moment == pytest.approx(m, rel=1e-5, abs=1e-2)
        assert (square, count) == (pytest.approx(s), c)


def test_what_coefficients_predict_is_the_product_with_their_columns(data) -> None:
    p = problem(np.ones(W, bool), *data)
    beta = np.array([0.3, -1.0])
    assert p.predicted(p.at["g"][1:3], beta) == pytest.approx(p.x[:, p.at["g"][1:3]] @ beta, abs=1e-4)
