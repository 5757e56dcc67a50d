"""The recorder: it knows nothing of fleetlog, a case says all of it, and its keys add up with its logs."""

from __future__ import annotations

import ast
import filecmp
from dataclasses import replace
from pathlib import Path

import numpy as np
import oracle
import pytest
from cases import FAMILIES, Case, family
from effects import OUTSIDE, TERMS, Scope, draw
from loggers import LOGGERS
from paths import path
from power import HZ, balance
from recorder import play, record
from shifts import shift
from sites import KINDS, Site
from world import world

from fleetlog.physics.power import all_terms

HERE = Path(__file__).parent
SMALL = {"vehicles": 1, "hours": 0.25}
RECORDER = (
    "cases", "driving", "effects", "engine", "key", "layouts", "loggers", "observe", "oracle", "paths", "power",
    "recorder", "shifts", "sites", "streets", "traffic", "trucks", "world",
)  # fmt: skip


@pytest.mark.parametrize("module", RECORDER)
def test_the_recorder_shares_no_code_with_the_model(module: str) -> None:
    tree = ast.parse((HERE / f"{module}.py").read_text(encoding="utf-8"))
    imported = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not any(name.split(".")[0] == "fleetlog" for name in imported)


def test_every_term_of_the_vocabulary_can_be_concealed() -> None:
    nominal = {"gravity", "inertia", "rolling", "lift", "acceleration"}
    seen_in_traffic = {"congestion"}
    assert (
        set(TERMS)
        >= {t.name for t in all_terms().values() if t.parameters and t.told and t.in_vocabulary}
        - nominal
        - seen_in_traffic
    )


@pytest.mark.parametrize("name", FAMILIES)
def test_a_case_is_read_as_it_is_written(name: str) -> None:
    cases = family(name, range(1, 3))
    assert len({c.name for c in cases}) == len(cases)
    assert all(Case.parse(c.name) == replace(c, family="") for c in cases)


def test_a_recording_is_its_case_to_the_byte(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        record(Case(("grade", "waiting"), seed=7, logger="jitter", **SMALL), tmp_path / folder)
    names = [file.name for file in (tmp_path / "a").iterdir()]
    assert filecmp.cmpfiles(tmp_path / "a", tmp_path / "b", names, shallow=False)[0] == names
    assert len(names) == 5


@pytest.mark.parametrize("term", ["auxiliary_load", "copper_loss", "surface_resistance"])
def test_a_clean_twin_has_the_same_drives_and_the_key_tells_the_rest(term: str) -> None:
    (clean, _, _), (faulty, _, _) = (play(world(Case(t, seed=7, **SMALL))) for t in ((), (term,)))
    assert clean.drop("battery_power", "soc").equals(faulty.drop("battery_power", "soc"))
    w = world(Case((term,), seed=7, **SMALL))
    motion, _ = shift(w, 0, 0, np.random.default_rng([7, 8, 0, 0]))
    own = w.truck.own(np.random.default_rng([7, 7, 0]))
    more = balance(motion, own, w.effects, 0, w.truck)[0] - balance(motion, own, [], 0, w.truck)[0]
    logged = faulty["battery_power"].sum() - clean["battery_power"].sum()
    assert logged == pytest.approx(more.sum() / HZ, rel=0.03)


def test_power_in_a_clean_log_is_the_truth_within_its_noise() -> None:
    w = world(Case(seed=3, **SMALL))
    log, _, _ = play(w)
    motion, _ = shift(w, 0, 0, np.random.default_rng([3, 8, 0, 0]))
    truth = balance(motion, w.truck.own(np.random.default_rng([3, 7, 0])), [], 0)[0]
    second = np.convolve(truth, np.ones(HZ) / HZ, "same")
    times = (log["timestamp"].to_numpy() / 1000.0 - motion.t[0]) * HZ
    seen, true = log["battery_power"].to_numpy(), second[times.round().astype(int)]
    off = seen - true
    assert abs(off.mean()) < 5.0
    assert np.sqrt((off**2).mean()) < 0.05 * np.sqrt((true**2).mean())
    used = -np.diff(log["soc"].to_numpy()[[0, -1]])[0] * 3600.0 * w.truck.capacity
    assert used == pytest.approx(truth[int(times[0]) : int(times[-1])].sum() / HZ, rel=0.005)


def test_kinetic_energy_comes_back_when_a_truck_halts() -> None:
    w = world(Case(seed=4, **SMALL))
    motion, _ = shift(w, 0, 0, np.random.default_rng(0))
    lossless = replace(w.truck, efficiency=1.0, regeneration=1.0, rolling=0.0, power=0.0)
    motion = replace(motion, lift=0.0 * motion.lift)
    power = balance(motion, lossless, [], 0)[0]
    assert abs(power.sum()) < 0.005 * np.abs(power).sum()


@pytest.mark.parametrize("kind", KINDS)
def test_paths_hold_no_corner_tighter_than_the_site_has(kind: str) -> None:
    rng = np.random.default_rng(11)
    site = Site.draw(kind, rng)
    driven = 0
    for _ in range(30):
        start, goal = (int(k) for k in rng.integers(len(site.layout.xy), size=2))
        legs = site.route(start, goal, rng)
        if not legs:
            continue
        way = path(site, legs)
        driven += 1
        ends = site.layout.xy[[start, goal]]
        assert np.hypot(way.x[[0, -1]] - ends[:, 0], way.y[[0, -1]] - ends[:, 1]).max() < 1.0
        assert np.abs(way.bend).max() < 1.5 / site.layout.radius
    assert driven > 15


@pytest.mark.parametrize("name", LOGGERS)
def test_loggers_write_increasing_times_and_their_own_columns(name: str) -> None:
    log, _, _ = play(
        world(Case(logger=name, seed=5, vehicles=1, hours=1.2 if LOGGERS[name].charging else 0.25))
    )
    times = log["timestamp"].to_numpy()
    assert (np.diff(times) > 0).all()
    assert not set(LOGGERS[name].without) & set(log.columns)
    assert np.median(np.diff(times)) == pytest.approx(1000.0 * LOGGERS[name].interval, rel=0.1)
    if LOGGERS[name].charging:
        assert log["soc"].diff().max() > (0.01 if name == "swap" else 1e-5)
    if name == "charge_in":
        assert log["battery_power"].min() < -5000.0
    if name == "charge_out":
        assert log["battery_power"].min() > -5000.0


@pytest.mark.parametrize("term", [*TERMS, *OUTSIDE])
def test_every_effect_shows_less_when_it_is_weaker(term: str) -> None:
    shares = []
    for strength in (1.0, 0.125):
        hours = 1.8 if term in ("hour", "surface_resistance") else 0.6
        w = world(Case((term,), strength, seed=9, vehicles=1, hours=hours))
        _, seen, legs = play(w)
        shares.append(oracle.share(w.effects[0], oracle.channels(seen, legs))["share"])
    assert shares[0] > shares[1] >= 0.0


def test_an_effect_stays_within_its_scope() -> None:
    w = world(Case(seed=2, **SMALL))
    motion, _ = shift(w, 0, 0, np.random.default_rng(0))
    begin = float(motion.t[len(motion) // 2])
    scope = Scope(vehicles=(0,), begin=begin)
    effect = draw("auxiliary_load", w.site, w.truck, 1.0, 2, sign=1.0, scope=scope)
    clean = balance(motion, w.truck, [], 0)[0]
    more = balance(motion, w.truck, [effect], 0)[0] - clean
    added = effect.parameters["power"] - w.truck.power
    assert more[motion.t < begin] == pytest.approx(0.0, abs=1e-6)
    assert more[motion.t >= begin] == pytest.approx(added)
    assert balance(motion, w.truck, [effect], 1)[0] == pytest.approx(clean)
    drift = replace(effect, scope=Scope(begin=float(motion.t[0]), end=float(motion.t[-1]), drift=True))
    grown = balance(motion, w.truck, [drift], 0)[0] - clean
    assert grown.mean() == pytest.approx(added / 2.0, rel=0.01)


def test_the_oracle_finds_nothing_where_nothing_is_and_no_tolerance_beyond_it() -> None:
    _, seen, legs = play(world(Case(seed=6, vehicles=2, hours=0.6)))

    floor = oracle.channels(seen, legs)["battery_power"][""]
    _, seen, legs = play(world(Case(seed=6, wrong="mass+", vehicles=2, hours=0.6)))
    assert oracle.channels(seen, legs)["battery_power"][""] == pytest.approx(floor, rel=0.1)
