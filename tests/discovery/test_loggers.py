"""Every truck has its own logger: a poor one widens what is said of its own truck, and hides nothing of others."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from fleetlog.discovery.channels.base import Channel, Unit
from fleetlog.discovery.model import FLEET, Scope
from fleetlog.discovery.recording import sensors
from fleetlog.discovery.recording.blocks import Windows
from fleetlog.discovery.recording.day import Day
from fleetlog.discovery.recording.fleet import Fleet
from fleetlog.discovery.recording.splits import Split
from fleetlog.discovery.report import others
from fleetlog.discovery.report.finding import ChannelFit, Lasting, Verdict
from fleetlog.discovery.report.output import head
from fleetlog.discovery.search.problem import Table, learn
from fleetlog.discovery.settings import SETTINGS
from fleetlog.physics.power import all_terms

TERMS = {t.fault: t for t in all_terms().values() if t.acts == "sensor"}


def fleet(*steps: float) -> Fleet:
    """One vehicle-day for each time between rows [s]."""
    days = [SimpleNamespace(vehicle=v, step=s, known={"battery_power"}) for v, s in enumerate(steps)]
    names = tuple(f"T{v + 1}" for v in range(len(steps)))
    return Fleet(cast(list[Day], days), names, None, None, {}, {})  # type: ignore[arg-type]


def channel(*own: float, sparse: tuple[int, ...] = ()) -> Channel:
    """The errors of a model in each truck."""
    found = SimpleNamespace(fleet=fleet(*own), own_error=np.array(own), sparse=frozenset(sparse))
    found.plain_error = Channel.plain_error.fget(found)  # type: ignore[attr-defined]
    return cast(Channel, found)


def test_a_poor_logger_hides_nothing_of_the_others() -> None:
    alone, beside = channel(0.01, 0.01, 0.01), channel(0.01, 0.01, 0.01, 0.08)
    assert Channel.error_of(alone, FLEET) == pytest.approx(0.01)
    assert Channel.error_of(beside, FLEET) == pytest.approx(0.01, rel=0.05)
    assert Channel.error_of(beside, Scope((3,))) == pytest.approx(0.08)
    assert Channel.error_of(channel(0.01, 0.0001, sparse=(1,)), FLEET) == pytest.approx(0.01)


def test_only_trucks_whose_rows_are_too_far_apart_are_not_judged() -> None:
    mixed = fleet(1.0, 30.0, 1.1, 5.0)
    assert mixed.sparse(10.0) == {1}
    assert mixed.loggers == [[0, 2], [1], [3]]


def test_noise_is_that_of_each_kind_of_logger() -> None:
    """Windows of one truck scatter five times as much: those of the other weigh as much as without it."""
    rng, count = np.random.default_rng(2), np.arange(1500)
    level, whole, tables = np.full(1500, 40.0), np.ones(1500, bool), list[Table]()
    for vehicle, noise in enumerate((1.0, 5.0)):
        w = Windows(
            trip=count // 10, vehicle=np.full(1500, vehicle), day=0 * count, edge=count,
            duration=np.full(1500, 10.0), distance=level, x=level, y=level, time=count * 10.0,
        )  # fmt: skip
        recorded = level + noise * rng.normal(size=1500)
        unit = Unit(w, recorded, whole, np.zeros(1500), level, np.ones(1500), 0 * count, None)
        tables.append((unit, level, rng.normal(size=(1500, 2)).astype(np.float32)))
    found = learn(tables, SETTINGS, 0.0, lambda w: w.trip, [([0], 0.0), ([1], 0.0)])
    variance = [float(np.median(1.0 / found.plain(unit))) for unit, _, _ in tables]
    assert variance == pytest.approx([1.0, 25.0], rel=0.25)


@pytest.mark.parametrize("lag", [2.0, 3.0])
def test_a_mean_and_a_late_clock_of_two_trucks_are_told_apart(
    lag: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three trucks one is late and one tells means: neither is taken for the other, nor the third."""
    late = sensors._Look(lag, 0.5, 0.1, 2.0 * lag, 0.3)
    mean = sensors._Look(2.5, 0.5, 0.3, 5.0, 0.1)
    right = sensors._Look(0.0, 0.1, 0.1, 1.0, 0.2)
    looks = [(v, look) for v, look in enumerate((late, mean, right)) for _ in range(6)]
    monkeypatch.setattr(Fleet, "each", lambda *_: iter([looks]))
    faults, mended = sensors._clock(fleet(1.0, 5.0, 1.0), cast(Split, None), TERMS)
    assert [(f.term, f.off.by_vehicle) for f in faults] == [
        ("averaging", {1: 5.0}),
        ("clock_offset", {0: lag}),
    ]
    assert mended.lag == {0: lag, 1: 2.5}
    assert mended.interval == {1: 5.0}


@pytest.mark.parametrize(("vehicle", "lasts"), [(None, False), (0, True), (1, False)])
def test_what_lasts_is_held_against_the_trucks_that_show_it(vehicle: int | None, lasts: bool) -> None:
    """The sums over trips weigh all trucks alike: a poor logger may make all of them."""
    assert others.lasts(Lasting(0.03, 1e-9, vehicle), channel(0.01, 0.08), SETTINGS) is lasts


def test_a_verdict_names_what_was_not_judged() -> None:
    judged = ChannelFit("battery_power", "", 0.03, 0.03, 0.03)
    hidden = ChannelFit("soc", "", 0.2, 0.2, 0.2, "noise hides it")
    whole, part = Verdict([judged], [], []), Verdict([judged], [], [], left_out=["T2"])
    assert whole.passes and not part.passes and part.word == "none"
    assert "truck T2" in head(part) and "truck" not in head(whole)
    some = Verdict([judged, hidden], [], [])
    assert not some.passes and "Not judged: soc." in head(some)
