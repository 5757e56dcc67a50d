"""Charger placement end to end."""

import numpy as np
import pytest

from fleetlog.analysis.chargers import chargers
from fleetlog.analysis.placement.report import lines_of
from fleetlog.errors import ArgumentError, DataError


def test_sites_beat_random_and_state_their_gap(fleet):
    s = chargers(fleet, k=3).summary
    assert s["demand"] == "urgency" and s["proven_gap"] == 0
    assert s["reach"]["mean"] <= s["baselines"]["random"]["best_of_200"] + 1e-9
    assert s["stability"]["left_out"] == "vehicle" and s["stability"]["runs"] == 6
    assert s["plugs_peak"] >= 1


def test_more_sites_are_never_farther(fleet):
    means = [chargers(fleet, k=k).summary["reach"]["mean"] for k in (1, 2, 4, 8)]
    assert means == sorted(means, reverse=True)


def test_rank_of_the_flow_follows_the_heat_and_says_that_it_must(fleet):
    s = chargers(fleet).summary
    assert s["rank_heat_spearman"] > 0.8 and "construction" in s["rank_heat_note"]
    assert chargers(fleet, variant="vote").summary["rank_heat_note"] is None


@pytest.mark.parametrize("method", ["spaced", "topk", "cover", "pmedian"])
@pytest.mark.parametrize("variant", ["flow", "vote", "urgency"])
def test_every_method_gives_at_most_k(fleet, method, variant):
    r = chargers(fleet, k=4, method=method, variant=variant, metric="time")
    assert 1 <= len(r.places["sites"]) <= 4 and np.isclose(r.places["sites"].served_share.sum(), 1)


@pytest.mark.parametrize("method", ["spaced", "topk", "cover", "pmedian"])
def test_a_charger_that_nobody_would_use_is_not_advised(tmp_path, method):
    """One truck waits for its charge at one end of the site alone, and drives everywhere."""
    from fleetlog.store import Dataset, DatasetWriter

    from .conftest import grid_site, walk

    site = grid_site()
    truck = walk(site.roads(), 1, 1800)
    alone = truck.with_columns(soc=np.where(truck.floats("x") < 15.0, 0.2, 0.9))
    with DatasetWriter.create(tmp_path / "d", "recorded", site) as w:
        w.write(alone)
    r = chargers(Dataset(tmp_path / "d"), k=12, method=method, spacing=15.0)
    sites = r.places["sites"]
    assert r.summary["demand"] == "urgency" and (sites.served_share > 0.0).all() and len(sites) < 12
    told = r.summary["notices"][-1:]
    assert method == "cover" or told == [
        f"all demand is served by {len(sites)} of 12 sites; the others would stand idle"
    ]


def test_forced_and_forbidden(fleet):
    free = next(s for s in chargers(fleet, k=2).summary["sites"] if s != "n00")
    s = chargers(fleet, k=2, force=("charger-1",), forbid=(free,)).summary["sites"]
    assert "n00" in s and free not in s
    with pytest.raises(DataError, match="did you mean"):
        chargers(fleet, force=("n0",))
    with pytest.raises(DataError, match="1 site cannot hold the 2 that are forced or kept"):
        chargers(fleet, k=1, force=("n00", "n11"))


@pytest.mark.parametrize(
    "force", [{"force": ("n11", "n00")}, {"force": ("charger-1",)}, {"keep_existing": True}]
)
def test_a_site_that_must_be_and_must_not_is_wrong_usage(fleet, force):
    """By whatever name: the charger stands at the vertex."""
    with pytest.raises(ArgumentError, match="vertex 'n00' must be a site and must not"):
        chargers(fleet, k=2, forbid=("n00",), **force)


def test_falling_back_is_said_aloud(fleet, tmp_path):
    from fleetlog.store import Dataset, DatasetWriter

    with DatasetWriter.create(tmp_path / "d", "recorded", fleet.site) as w:
        for t in fleet.days():
            w.write(t.with_columns(soc=np.ones(len(t))))
    s = chargers(Dataset(tmp_path / "d"), k=2).summary
    assert s["demand"] == "standing" and "50 %" in s["notices"][0]


def test_a_plan_that_its_check_shows_to_be_worse_is_not_advised(fleet):
    """The first line is the answer: what is there is kept, unless the plan does more or leaves more charge."""
    r = chargers(fleet, k=3)
    run = {"plugs": 2, "soc_lowest": 0.2, "soc_mean": 0.5, "waiting_for_plug_h": 7.0, "empty_trucks": 0}
    before = run | {"soc_end_mean": 0.52, "tasks_given": 1373, "tasks_done": 976}

    def told(tasks, charge):
        after = before | {"tasks_done": tasks, "soc_end_mean": charge}
        check = {"vehicles": 8, "hours": 8.0, "soc_start": 0.6, "before": before, "after": after}
        return lines_of(r.summary | {"check": check}, r.places["sites"], ["charger-2"])

    worse = told(894, 0.48)
    assert worse[0] == "Keep the chargers as they are: in the check the planned ones do 82 tasks fewer."
    assert worse[1].startswith("The plan was to install chargers at (")
    assert "This plan does not need charger-2." in worse
    for better in (told(1100, 0.48), told(970, 0.7)):
        assert better[0].startswith("Install chargers at (") and "(vertex n" in better[0]
    assert any(line.startswith("The demand (standing below 50 % charge) is ") for line in worse)
