"""Laws of the road network."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetlog.core.network import Edge, build_network, reversed_edge
from fleetlog.core.site import Frame, Place, Site, Zone, site_from_dict, site_to_dict
from fleetlog.errors import SiteError


def edge(name, start, end, *points, **more):
    return Edge(
        name, start, end, np.array([(*p, 0.0)[:3] for p in points], float), more.pop("road", name), **more
    )


def cross():
    """Four two-way arms meeting in c."""
    arms = [
        edge(f"r{i}", "c", f"n{i}", (0, 0), (10 * math.cos(a), 10 * math.sin(a)))
        for i, a in enumerate((0, 1.57, 3.14, 4.71))
    ]
    return build_network([e for a in arms for e in (a, reversed_edge(a))])


def test_a_road_and_its_reverse_know_each_other():
    n = cross()
    for i in range(len(n)):
        j = n.reverse[i]
        assert n.reverse[j] == i and n.roads[i] == n.roads[j] and n.start[i] == n.end[j]


def test_no_turning_round_but_at_a_dead_end():
    n = cross()
    inbound = n.edge("-r0")
    assert set(n.successors(inbound)) == {n.edge(f"r{i}") for i in (1, 2, 3)}
    assert list(n.successors(n.edge("r0"))) == [inbound]


@given(
    st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-5, 5)), min_size=2, max_size=8),
    st.floats(0, 1),
)
def test_position_is_at_its_distance_along_the_line(points, share):
    p = np.array(points)
    if np.linalg.norm(np.diff(p, axis=0), axis=1).min() < 1e-3:
        return
    n = build_network([edge("a", "s", "e", (0, 0), (1, 0)), Edge("b", "e", "f", p, "b")])
    i = np.array([1], np.int32)
    s = share * n.length[1]
    k, f = n.segment(i, np.array([s]))
    walked = n.distance[k[0]] + f[0] * (n.distance[k[0] + 1] - n.distance[k[0]])
    assert walked == pytest.approx(s, abs=1e-9)
    assert np.allclose(n.position(i, np.array([0.0]))[0], p[0])
    assert np.allclose(n.position(i, n.length[i])[0], p[-1])


def test_slope_is_odd_in_direction():
    up = edge("up", "a", "b", (0, 0, 0), (10, 0, 1))
    n = build_network([up, reversed_edge(up)])
    s = n.slope(np.array([0, 1], np.int32), np.array([5.0, 5.0]))
    assert s[0] == pytest.approx(math.atan(0.1)) and s[1] == -s[0]
    assert n.has_elevation


def test_a_site_survives_json():
    import json

    n = cross()
    site = Site(
        "s", Frame(50, 9, 0.1), n, "left", (Place("p", "charge", 1, 2),), (Zone("z", np.eye(3)[:, :2], 2.0),)
    )
    again = site_from_dict(json.loads(json.dumps(site_to_dict(site))))
    assert again.frame == site.frame and again.places[0].id == "p" and again.zones[0].speed_limit == 2.0
    m = again.network
    assert (
        m.edge_ids == n.edge_ids
        and np.array_equal(m.next_edges, n.next_edges)
        and np.array_equal(m.points, n.points)
    )
    assert np.array_equal(m.reverse, n.reverse)


def test_errors_name_the_nearest():
    with pytest.raises(SiteError, match="did you mean 'r1'"):
        cross().edge("r11")
    a = edge("a", "x", "y", (0, 0), (1, 0))
    with pytest.raises(SiteError, match="share the id 'a'"):
        build_network([a, a])


def test_a_closed_road_is_one_that_was_never_drawn():
    def arms(numbers):
        ends = [(10 * math.cos(a), 10 * math.sin(a)) for a in (0, 1.57, 3.14, 4.71)]
        drawn = [edge(f"r{i}", "c", f"n{i}", (0, 0), ends[i]) for i in numbers]
        return build_network([e for a in drawn for e in (a, reversed_edge(a))])

    whole, three = arms(range(4)).without(["r2"]), arms([0, 1, 3])
    assert whole.edge_ids == three.edge_ids and whole.roads == three.roads
    for name in ("points", "distance", "reverse", "next_first", "next_edges"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(three, name))


def test_one_direction_can_be_closed_and_who_is_left_without_a_way_turns_round():
    n = cross().without(["-r0", "r1", "r2", "r3"])
    assert set(n.edge_ids) == {"r0"}
    n = cross().without(["r1", "r2", "r3"])
    assert n.successors(n.edge("-r0")).tolist() == [n.edge("r0")]
    with pytest.raises(SiteError, match="no edge 'r9'"):
        cross().without(["r9"])


def test_an_error_names_no_more_than_a_line_holds():
    from fleetlog.errors import nearest

    few, many = [f"road{i:03d}" for i in range(7)], [f"road{i:03d}" for i in range(700)]
    assert all(name in nearest("xyz", few) for name in few)
    assert "road039" in nearest("xyz", many) and nearest("xyz", many).endswith("and 660 more")
    assert nearest("raod012", many) == "did you mean 'road012'?"
