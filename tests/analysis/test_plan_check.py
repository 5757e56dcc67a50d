"""Plans tried in the simulator, costs of driving, capacities."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetlog.analysis.chargers import chargers
from fleetlog.analysis.placement.plan import driving_costs, edge_energies
from fleetlog.analysis.placement.report import try_plan, with_chargers
from fleetlog.analysis.placement.select import p_median
from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.truck import truck_from_dict
from fleetlog.errors import DataError
from fleetlog.roads import load_site
from fleetlog.simulate.engine import Settings
from tests.analysis.conftest import grid_site, write

TRUCK = truck_from_dict({
    "name": "t", "chassis": {"mass": 3000.0, "rated_load": 1500.0, "turn_radius": 2.5},
    "battery": {"voltage": 48.0, "capacity_wh": 6000.0},
})  # fmt: skip


def one_charger():
    """The sample plant with one of its chargers."""
    site, _ = load_site(Path(__file__).parents[2] / "sample_data" / "site.toml")
    return replace(site, places=tuple(p for p in site.places if p.id != "charger-2"))


def hill(slope=0.05):
    p = np.array([[0, 0, 0], [100.0, 0, 100.0 * slope]])
    up = Edge("h", "low", "high", p, "h", 2.0)
    return build_network([up, reversed_edge(up)])


def test_energy_of_an_edge_follows_the_nominal_model():
    n = hill()
    up, down = edge_energies(n, TRUCK)
    m, g, length = 3000.0, 9.81, float(n.length[0])
    angle = np.arctan(0.05)
    drive = TRUCK.drive
    force = m * g * (TRUCK.resistance.rolling * np.cos(angle) + np.sin(angle))
    expected = (force * length / drive.efficiency + TRUCK.auxiliary.power * length / 2.0) / 3600
    assert up == pytest.approx(expected, rel=2e-3)
    assert 0 <= down < up
    c = driving_costs(n, "energy", TRUCK)
    assert c[0, 1] == pytest.approx(up) and c[1, 0] == pytest.approx(max(down, 1e-9))


def test_on_level_ground_energy_grows_with_distance():
    n = grid_site().roads()
    d, e, t = (driving_costs(n, m, TRUCK) for m in ("distance", "energy", "time"))
    assert np.allclose(e / np.where(d > 0, d, 1), e[0, 1] / d[0, 1] * (d > 0))
    assert np.allclose(t, d / 3.0)
    with pytest.raises(DataError, match="--truck"):
        driving_costs(n, "energy")


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 1.0))
def test_a_capacity_holds_and_never_helps(seed, capacity):
    rng = np.random.default_rng(seed)
    a, b = rng.random((8, 2)), rng.random((12, 2))
    w, d = rng.random(12), np.hypot(*(b[:, None] - a[None]).transpose(2, 0, 1))
    free, tight = p_median(w, d, 4), p_median(w, d, 4, capacity=capacity)
    assert tight.objective >= free.objective - 1e-9
    if len(tight.served):
        assert tight.served.max() <= capacity + 1e-6 and tight.served.sum() == pytest.approx(1)


def test_capacities_that_cannot_be_kept_say_so():
    with pytest.raises(DataError, match="cannot serve"):
        p_median(np.ones(4), np.ones((4, 4)), 2, capacity=0.3)


def test_existing_chargers_stay_and_idle_sites_are_left_out(fleet):
    kept = chargers(fleet, k=2, keep_existing=True)
    assert "n00" in kept.summary["sites"]
    assert any(line.startswith("Keep charger-1 (") for line in kept.lines)
    assert not any("Install" in line and "n00" in line for line in kept.lines)
    r = chargers(fleet, k=12)
    assert (r.places["sites"].served_share > 0).all()
    assert len(r.places["sites"]) == 12 or any("idle" in n for n in r.summary["notices"])


def test_the_plan_replaces_the_chargers_plug_by_plug(fleet):
    sites = chargers(fleet, k=2).places["sites"].assign(plugs=[2, 1])
    planned = with_chargers(fleet.site, sites)
    spots = [p for p in planned.places if p.kind == "charge"]
    assert len(spots) == 3 and len({p.id for p in spots}) == 3
    assert [p for p in planned.places if p.kind != "charge"] == [
        p for p in fleet.site.places if p.kind != "charge"
    ]


def test_more_plugs_shorten_the_wait_and_the_trial_repeats_itself(tmp_path):
    data = write(tmp_path / "d", range(4), 900, site=one_charger())
    sites = chargers(data, k=3).places["sites"].assign(plugs=2)
    fleet = Settings(4, 2700.0, seed=3, soc=0.32)
    first = try_plan(data, sites, TRUCK, fleet)
    before, after = first["before"], first["after"]
    assert before["plugs"] == 1 and after["plugs"] == 6
    assert before["waiting_for_plug_h"] > after["waiting_for_plug_h"]
    assert after["charged_kwh"] > before["charged_kwh"] and after["soc_mean"] > before["soc_mean"]
    assert try_plan(data, sites, TRUCK, fleet) == first


def test_the_check_is_in_summary_lines_and_picture(tmp_path):
    data = write(tmp_path / "d", range(3), 600, site=one_charger())
    r = chargers(data, k=2, truck=TRUCK, check=True, vehicles=3, duration=600.0)
    assert {"before", "after"} <= set(r.summary["check"])
    assert any("planned chargers" in line for line in r.lines)
    assert sum(s.name.startswith("simulated_") for s in r.shapes) == 3
