"""Maps as they come: one-way exits, islands, lanes that lead nowhere, roundabouts, places that nobody can leave again."""

import re
from dataclasses import replace

import numpy as np
import pytest
from laws import keeps_the_laws
from simulated_sites import TRUCK, place, road

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Site
from fleetlog.errors import SiteError
from fleetlog.simulate.junctions import find_junctions
from fleetlog.simulate.tasks import Demand, Task
from fleetlog.simulate.track import build_track
from fleetlog.simulate.ways import main_part, parts


def line(*points):
    return np.array(points, dtype=float)


def ring(centre=(0.0, 0.0), radius=30.0, name="r"):
    """A one-way roundabout of four quarters, counter-clockwise; its nodes are r0 (east), r1 (north), r2, r3."""
    edges = []
    for k in range(4):
        angle = np.linspace(k, k + 1, 13) * np.pi / 2
        points = np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        edges += road(f"{name}q{k}", f"{name}{k}", f"{name}{(k + 1) % 4}", points, oneway=True)
    return edges


def lanes(length=150.0, apart=3.5):
    """Two lanes side by side in opposite directions that lead nowhere, as a road of OpenDRIVE."""
    there, back = line([0, 0, 0], [length, 0, 0]), line([length, apart, 0], [0, apart, 0])
    edges = [Edge("1:0:-1", "a", "b", there, "1:0:-1", 3.0), Edge("1:0:1", "c", "d", back, "1:0:1", 3.0)]
    return build_network(edges, turns=[])


def one_way_exit():
    return build_network([*ring(), *road("exit", "r0", "out", line([30, 0], [130, 0]), oneway=True)])


def islands():
    return build_network([*ring(), *road("far", "f1", "f2", line([200, 0], [240, 0]))])


def dead_ends():
    return build_network([*ring(), *road("arm", "r1", "tip", line([0, 30], [0, 110]))])


def sliver():
    """A loop with a lane of a millimetre between two long ones."""
    edges = ring()[:3]
    angle = np.linspace(3, 4, 13) * np.pi / 2
    points = 30.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    edges += road("last", "r3", "s", points, oneway=True)
    return build_network([*edges, *road("sliver", "s", "r0", line([30, 0], [30, 0.001]), oneway=True)])


MAPS = [sliver, one_way_exit, islands, dead_ends, lanes]


@pytest.mark.parametrize("make", MAPS)
@pytest.mark.parametrize("trucks", [1, 5])
def test_a_fleet_runs_on_any_map_and_keeps_the_laws(make, trucks, simulated):
    network = make()
    outcome = simulated(Site("map", network=network), trucks, 600.0, seed=trucks)
    keeps_the_laws(outcome, network)
    assert outcome.summary.count.tasks_done > 0
    assert outcome.summary.longest_wait_s < 60.0


def test_what_cannot_be_left_again_is_left_out_and_said(simulated):
    outcome = simulated(Site("map", network=one_way_exit()), 3, 600.0)
    assert any("1 of 5 lanes (100 m) cannot be reached and left again" in n for n in outcome.summary.notes)
    assert not {e for t in outcome.tracks for e in t.labels("edge_id").strings()} & {"exit"}


def test_both_ways_round_a_ring_are_driven_and_it_is_said_where_they_meet(simulated):
    edges = [way for one in ring() for way in (one, reversed_edge(one))]
    outcome = simulated(Site("ring", network=build_network(edges)), 1, 1800.0, interval=1.0)
    told = [n for n in outcome.summary.notes if "lanes" in n]
    assert len(told) == 1 and told[0].startswith("4 of 8 lanes (188 m) joined to the others by no turn")
    driven = {e for t in outcome.tracks for e in t.labels("edge_id").strings() if e}
    assert {e.startswith("-") for e in driven} == {True, False}


@pytest.mark.parametrize("narrow", [0, 1, 4])
def test_stated_widths_below_that_of_a_truck_are_counted_and_named(narrow, simulated):
    widths = [0.9] * narrow + [4.0] * 3 + [float("nan")] * 4
    edges = [replace(edge, width=width) for edge, width in zip(ring(), widths, strict=False)]
    notes = simulated(Site("ring", network=build_network(edges)), 1, 60.0).summary.notes
    told = [n for n in notes if "narrower than a truck of 1.2 m" in n]
    assert len(told) == (narrow > 0)
    assert all(f"{narrow} road{'s' * (narrow > 1)} narrower" in n and "'rq0'" in n for n in told)
    assert not [n for n in notes if re.search(r"\b1 [a-z ]+s\b", n)], "one of a thing is no plural"


def test_turning_round_at_open_ends_is_said_and_kept_with_the_dataset(simulated):
    outcome = simulated(Site("map", network=lanes()), 2, 600.0)
    assert "turn round at open ends (2)" in outcome.summary.notes[0]
    assert (parts(outcome.dataset.site.network) == 0).all()


def test_a_place_on_an_exit_is_left_out_with_its_tasks(simulated):
    places = (place(1, "pick", 0, 33), place(1, "drop", -33, 0), place(2, "drop", 90, -3))
    tasks = [Task(None, "pick1", f"drop{1 + k % 2}", 500.0, 30.0 * k) for k in range(4)]
    site = Site("map", network=one_way_exit(), places=places)
    outcome = simulated(site, 2, 900.0, demand=Demand(tasks, endless=False))
    assert any("cannot be reached" in n and n.endswith(": 'drop2'") for n in outcome.summary.notes)
    assert any("2 tasks" in n for n in outcome.summary.notes)
    assert outcome.summary.count.tasks_done == 2


def test_nobody_is_to_stand_on_a_lane_that_is_too_short_to_be_on():
    junctions = find_junctions(build_track(sliver(), TRUCK), TRUCK)
    assert junctions.capacity.tolist() == [*(c for c in junctions.capacity[:4] if c > 0), 0]


def test_the_part_with_most_places_counts():
    network = islands()
    near = np.array([network.edge("far"), network.edge("-far")])
    assert set(np.flatnonzero(main_part(network, []))) == set(range(4))
    assert set(np.flatnonzero(main_part(network, [near]))) == set(near)


def test_a_map_without_a_way_back_is_one_line(simulated):
    lone = build_network(road("a", "p", "q", line([0, 0], [90, 0]), oneway=True))
    with pytest.raises(SiteError) as error:
        simulated(Site("map", network=lone), 1, 60.0)
    assert "no lane of the map leads back" in str(error.value)
    assert "\n" not in str(error.value)
