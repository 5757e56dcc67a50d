"""Laws of the statistics: against other authorities, and against the long way round."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, minimize
from scipy.stats import kstest

from fleetlog.discovery.hypotheses.hypothesis import Hypothesis
from fleetlog.discovery.hypotheses.sources import ErrorSource, FieldSource, FreeCurve, KnobSource, lay_out
from fleetlog.discovery.model import Knob
from fleetlog.discovery.report.finding import Lasting
from fleetlog.discovery.search import finish, forward
from fleetlog.discovery.search.joint import Size
from fleetlog.discovery.search.judge import common, lasting, noise_floor, p_value
from fleetlog.discovery.search.ridge import Normal, Prior, Sums, cross_validated, solve


@given(st.integers(0, 10_000))
@example(1104)  # Changing all sides together goes in a circle
def test_the_bounded_fit_is_that_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(60, 6)) @ rng.normal(size=(6, 6)), rng.normal(size=60)
    precision, centre = rng.uniform(0.1, 5.0, 6), rng.normal(size=6)
    low, high = -rng.uniform(0.05, 1.0, 6), rng.uniform(0.05, 1.0, 6)
    mine = solve(x.T @ x, x.T @ y, Prior(precision, centre, low, high))
    wide = np.vstack([x, np.diag(np.sqrt(precision))])
    theirs = lsq_linear(wide, np.concatenate([y, np.sqrt(precision) * centre]), (low, high), tol=1e-12).x
    assert mine == pytest.approx(theirs, abs=1e-5)


def test_a_fit_ends_where_columns_say_the_same_but_for_rounding() -> None:
    """A load and its threshold beside hats of the temperature, as summed in single precision."""
    upper = np.zeros((7, 7))
    upper[np.triu_indices(7)] = [
        1.3449475094676018, 16.88588237762451, 91.21730375289917, 77.32994270324707, 85.52609491348267,
        89.92008399963379, 32.04487919807434, 216.37778663635254, 1321.2560806274414, 1033.1770248413086,
        1008.1860504150391, 968.9255218505859, 310.79079246520996, 19497.683959960938, 4921.318084716797,
        0.11008129268884659, 0.0, 0.0, 15124.888977050781, 3152.7272033691406, 0.001159606734290719, 0.0,
        16398.607177734375, 6106.372467041016, 0.01199067103152629, 17939.291381835938, 2930.3615188598633,
        6683.090194702148,
    ]  # fmt: skip
    moment = np.array([
        -0.21355355810374022, -2.7446833848953247, 28.747121334075928, -71.03115838766098, -43.237844944000244,
        72.19341364502907, -38.87527871131897,
    ])  # fmt: skip
    precision = np.array([1.0 / 3.6e7, 1e-6, *[1.0 / 30.0] * 5])
    low, high = np.full(7, -np.inf), np.full(7, np.inf)
    low[:2], high[:2] = (-766.1628165343691, -61.930689923715754), (5233.837183465631, 938.0693100762843)
    gram = upper + np.triu(upper, 1).T
    beta = solve(gram, moment, Prior(precision, np.zeros(7), low, high))
    inner = gram + np.diag(precision)

    def loss(x: np.ndarray) -> float:
        return float(0.5 * x @ inner @ x - moment @ x)

    best = minimize(loss, beta, jac=lambda x: inner @ x - moment, bounds=list(zip(low, high, strict=True)))
    assert ((beta >= low) & (beta <= high)).all()
    assert loss(beta) == pytest.approx(best.fun, rel=1e-6)


def test_a_cross_validated_loss_is_that_of_fits_that_have_not_seen_the_fold() -> None:
    rng = np.random.default_rng(0)
    x, fold = rng.normal(size=(200, 4)), rng.integers(0, 5, 200)
    y = x @ [1.0, 0.0, -2.0, 0.5] + rng.normal(size=200)
    free = Prior(np.full(4, 1e-9), np.zeros(4), np.full(4, -np.inf), np.full(4, np.inf))
    n = Normal(
        np.stack([x[fold == k].T @ x[fold == k] for k in range(5)]),
        np.stack([x[fold == k].T @ y[fold == k] for k in range(5)]),
        np.array([y[fold == k] @ y[fold == k] for k in range(5)]),
    )
    losses = []
    for k in range(5):
        beta = np.linalg.lstsq(x[fold != k], y[fold != k], rcond=None)[0]
        losses.append(((y - x @ beta)[fold == k] ** 2).sum())
    assert cross_validated(n, free).losses == pytest.approx(losses, rel=1e-6)


def test_sums_of_two_days_are_those_of_both() -> None:
    rng = np.random.default_rng(0)
    sources = [KnobSource(Knob("a", n)) for n in "ab"]
    layout = lay_out([*sources, ErrorSource("c", 1.0), FieldSource("d")], [1, 1, 1, 1])
    rows = [
        rng.normal(size=(300, 4)).astype(np.float32),
        rng.normal(size=300),
        rng.normal(size=300),
        rng.uniform(1, 2, 300),
    ]
    codes = [rng.integers(0, 3, 300), rng.integers(0, 3, 300), rng.integers(0, 2, 300)]
    parts = [Sums.empty(layout, 3, 2) for _ in range(3)]
    for sums, which in zip(parts, (slice(None), slice(0, 120), slice(120, 300)), strict=True):
        sums.add(*(r[which] for r in rows), *(c[which] for c in codes))
        sums.flush()
    whole, one, other = parts
    for name in ("fold", "slow", "own"):
        assert getattr(one, name) + getattr(other, name) == pytest.approx(
            getattr(whole, name), rel=1e-4, abs=1e-3
        )
    assert one.energy + other.energy == pytest.approx(whole.energy)


def test_p_values_are_uniform_where_nothing_is_concealed() -> None:
    """An effect found on some trips, tested on others of which it knows nothing; trips share noise."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(400):
        trip = np.repeat(np.arange(40), 8)
        noise = rng.normal(size=320) + rng.normal(size=40)[trip]
        found.append(p_value(noise, rng.normal(size=320), trip))
    assert kstest(found, "uniform").pvalue > 0.01


def test_an_effect_that_is_there_has_a_small_p_value() -> None:
    rng = np.random.default_rng(8)
    effect, trip = rng.normal(size=320), np.repeat(np.arange(40), 8)
    assert p_value(rng.normal(size=320) + effect, effect, trip) < 1e-4


@pytest.mark.parametrize("noise", [0.1, 1.0, 3.0])
def test_the_noise_floor_is_the_noise_whatever_the_effect(noise: float) -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 6, (3000, 2))
    residual = 4.0 * np.sin(x[:, 0]) + 2.0 * x[:, 1] + noise * rng.normal(size=3000)
    floor = noise_floor(x, residual, np.arange(3000) // 5, rng.random(3000) < 0.3)
    assert floor == pytest.approx(noise, rel=0.15, abs=0.12)


def test_what_trips_in_a_row_have_in_common_is_neither_noise_nor_what_all_have() -> None:
    """Noise of trips leaves p-values that are uniform; a load that comes and goes is told by its share."""
    rng = np.random.default_rng(5)
    trip, energy = np.arange(4000) // 10, rng.uniform(50.0, 150.0, 4000)

    def told(share: np.ndarray) -> Lasting:
        return lasting(common(share * energy, energy, trip))

    chance = [told(0.1 * rng.normal(size=400)[trip] + 0.05).p_value for _ in range(200)]
    assert kstest(chance, "uniform").pvalue > 0.01
    comes_and_goes = 0.06 * np.sin(2.0 * np.pi * trip / 40.0)
    lasts = told(comes_and_goes + 0.1 * rng.normal(size=4000))
    assert lasts.share == pytest.approx(0.06 / np.sqrt(2.0), rel=0.15) and lasts.p_value < 1e-6
    none = lasting(common(np.zeros(0), np.zeros(0), np.zeros(0, np.int64)))
    assert told(np.zeros(4000)) == none == Lasting(0.0, 0.5)


def test_a_gross_error_among_alike_windows_does_not_lower_the_noise_floor() -> None:
    rng = np.random.default_rng(3)
    for one in rng.integers(0, 400, 20):
        x, residual = rng.uniform(0, 3, (400, 2)), rng.normal(size=400)
        wanted = rng.random(400) < 0.3
        plain = noise_floor(x, residual, np.arange(400) // 5, wanted)
        residual[one] += 40.0
        assert noise_floor(x, residual, np.arange(400) // 5, wanted) > 0.8 * plain


def test_a_load_that_goes_on_and_off_is_told_at_rest() -> None:
    """Windows in a row share what is on for minutes; noise of one is gone with the next."""
    rng = np.random.default_rng(3)
    energy, noise = np.full(600, 5.0), rng.normal(0.0, 0.3, 600)
    on = np.where(np.arange(600) % 60 < 12, 8.0, 0.0)
    each = np.arange(600)
    told, none = (lasting(common(v, energy, each), 2) for v in (on + noise, noise))
    assert told.vehicle == 2 and told.p_value < 1e-3
    assert told.share == pytest.approx(float(np.std(on)) / 5.0, rel=0.15)
    assert none.p_value > 0.02 or none.share < 0.02


@pytest.mark.parametrize(("share", "told"), [(0.03, False), (0.12, True)])
def test_a_number_makes_way_for_a_slight_curve_only_where_it_is_no_larger_than_the_models_own_error(
    share: float, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A curve that says twice as much as the number is too slight: tolerances say most of what it is, too."""
    number = Hypothesis("rolling_resistance", (Knob("rolling_resistance", "coefficient"),))
    curve = Hypothesis(curve=FreeCurve("force", ("acceleration",), ((0.0, 1.0),)))
    now, better, best = (
        SimpleNamespace(score=s, chosen=c) for s, c in ((0, ()), (-40, (number,)), (-99, (curve,)))
    )
    for where, name, answer in (
        (forward, "_by_simplicity", [better]), (forward, "on_bound", False), (forward, "_follows", False),
        (forward, "_repeats", True), (forward, "verified", 0.0), (forward, "size_of", Size(share, 0.02)),
        (finish, "is_flat", False), (finish, "at_junctions", False), (finish, "counts", True),
    ):  # fmt: skip
        monkeypatch.setattr(where, name, lambda *_, answer=answer: answer)
    channel = SimpleNamespace(model_error=0.03, place_error=0.09)
    problem = SimpleNamespace(channel=channel, settings=SimpleNamespace(material=0.02, evidence=4.0))
    counting = forward._counting(problem, None, now, [best, better], [], [])  # type: ignore[arg-type]
    assert list(counting) == ([better] if told else [])
