"""Proposals for what no known term explains: the expression that made the data is found again, with its number."""

from __future__ import annotations

import numpy as np
import pytest

from fleetlog.discovery import generic
from fleetlog.discovery.proposal import _forms, _gain, _means


def test_hat_columns_hold_their_unit_and_the_mean_of_their_variable() -> None:
    rng = np.random.default_rng(3)
    knots = np.linspace(0.0, 4.0, 7)
    values, energy = rng.uniform(0.0, 4.0, (50, 20)), rng.uniform(0.5, 2.0, (50, 20))
    j, w = generic.hats(values, knots)
    columns = np.zeros((50, 7))
    for k in range(7):
        columns[:, k] = (energy * ((1.0 - w) * (j == k) + w * (j + 1 == k))).sum(axis=1)
    place = _means(columns, "speed", {"speed": knots})
    assert place is not None
    base, mean, _ = place
    assert base == pytest.approx(energy.sum(axis=1))
    assert mean == pytest.approx((energy * values).sum(axis=1) / energy.sum(axis=1))


@pytest.mark.parametrize(
    ("variables", "truth", "text"),
    [
        ("time since start", lambda x, y: np.exp(-x / 0.5), "exp("),
        ("soc", lambda x, y: np.maximum(0.4 - x, 0.0), "max(0."),
        ("ambient_temperature", lambda x, y: x**2, "T^2"),
        ("payload and speed", lambda x, y: x * y, "m_load v"),
    ],
)
def test_the_shape_that_made_the_data_predicts_best(variables: str, truth, text: str) -> None:  # type: ignore[no-untyped-def]  # a lambda
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0.0, 1.0, 800), rng.uniform(0.0, 3.0, 800)
    x = x * {"time since start": 3.0, "ambient_temperature": 20.0, "payload and speed": 900.0}.get(
        variables, 1.0
    )
    target = truth(x, y) + 0.02 * np.abs(truth(x, y)).mean() * rng.normal(size=800)
    folds = rng.integers(0, 5, 800)
    best = max(_forms(variables, x, y), key=lambda f: _gain(f.shape(x, y), target, folds))
    assert best.text.startswith(text)


def test_a_column_of_noise_gains_nothing_on_trips_held_out() -> None:
    rng = np.random.default_rng(6)
    gains = [_gain(rng.normal(size=300), rng.normal(size=300), rng.integers(0, 5, 300)) for _ in range(200)]
    assert np.mean(gains) < 0.0
