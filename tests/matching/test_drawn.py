"""What must happen on little drawn maps."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from drawing import draw

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads.matching import REASONS, Match, MatchParameters, match

KNOWN = MatchParameters(sigma=0.8, noise=0.5, beta=0.8, persistence=0.0)


def names(found: Match, network: Network) -> list[str]:
    return [
        network.edge_ids[e] if e >= 0 else REASONS[r] for e, r in zip(found.edge, found.reason, strict=True)
    ]


def visited(found: Match, network: Network) -> list[str]:
    listed = names(found, network)
    return [n for i, n in enumerate(listed) if i == 0 or listed[i - 1] != n]


def test_straight_on() -> None:
    network, track = draw("A-0-1-2-B-3-4-5-C")
    assert visited(match(track, network, KNOWN), network) == ["AB", "BC"]


def test_the_directed_edge_follows_the_motion() -> None:
    network, track = draw("A-5-4-3-B-2-1-0-C")
    assert visited(match(track, network, KNOWN), network) == ["-BC", "-AB"]


def test_round_a_corner() -> None:
    network, track = draw(
        """
A-0-1-2-3-B
|         4
|         5
D---------C
"""
    )
    assert visited(match(track, network, KNOWN), network) == ["AB", "BC"]


def test_a_heading_against_the_motion_is_an_axis_only() -> None:
    """Reversing: the forks lead, the heading of the log points back."""
    network, track = draw("A-0-1-2-B-3-4-5-C")
    backwards = track.with_columns(heading=np.full(len(track), np.pi))
    assert visited(match(backwards, network, KNOWN), network) == ["AB", "BC"]


def test_never_against_a_one_way_road() -> None:
    network, track = draw("A-0-1-2-3-B>4>5>6>C")
    ahead = match(track, network, KNOWN)
    assert visited(ahead, network) == ["AB", "BC"]
    network, track = draw("A-0-1-2-3-B<4<5<6<7<8<9<C")
    against = match(track, network, KNOWN)
    assert "CB" not in names(against, network)[5:]
    assert names(against, network)[-2:] == ["against a one-way road"] * 2


def test_a_one_way_detour_is_driven_round() -> None:
    """The way back on a one-way pair of aisles uses the other aisle."""
    network, track = draw(
        """
A>0>1>2>3>B
^         4
9         5
D<8<7<6<<<C
"""
    )
    assert visited(match(track, network, KNOWN), network) == ["AB", "BC", "CD", "DA"]


def test_turning_round_in_mid_aisle() -> None:
    network, track = draw("A-0-1-2-3-4-----------B", extra="A--8-7-6-5------------B")
    found = visited(match(track, network, KNOWN), network)
    assert found == ["AB", "-AB"]


def test_a_yard_off_the_map_has_a_reason_and_the_rest_is_matched() -> None:
    network, track = draw(
        """
A-0-1-2-3-B
            4
             5
              6 7 8 9 a b
                         c
                          d
                           E-e-f-g-h-F
"""
    )
    found = match(track, network, KNOWN)
    listed = names(found, network)
    assert listed[:4] == ["AB"] * 4 and listed[-4:] == ["EF"] * 4
    assert set(listed[5:13]) == {"no road within reach"}
    assert found.confidence[5:13].min() > 0.9


def test_roads_that_do_not_meet_start_a_new_chain() -> None:
    network, track = draw("A-0-1-2-3-B  C-5-6-7-8-D")
    found = match(track, network, KNOWN)
    assert visited(found, network) == ["AB", "CD"]
    assert [REASONS[r] for r in found.restart if r] == ["no connected path"]


def test_a_silence_starts_a_new_chain() -> None:
    network, track = draw("A-0-1-2-3-4-5-6-7-B")
    late = Trajectory("truck", track.time + np.where(np.arange(8) >= 4, 600_000_000, 0), track.columns)
    found = match(late, network, KNOWN)
    assert visited(found, network) == ["AB"]
    assert REASONS[found.restart[4]] == "gap" and (np.delete(found.restart, 4) == 0).all()


def test_a_standstill_is_one_place() -> None:
    network, track = draw("A-0-1-2-3-4-5-B")
    n = 40
    rng = np.random.default_rng(1)
    wait = rng.normal(0.0, 0.3, (n, 2)) + [track.floats("x")[3], track.floats("y")[3]]
    x = np.concatenate([track.floats("x")[:4], wait[:, 0], track.floats("x")[4:]])
    y = np.concatenate([track.floats("y")[:4], wait[:, 1], track.floats("y")[4:]])
    t = np.arange(len(x)) * 1_000_000
    found = match(Trajectory("truck", t, {"x": x, "y": y}), network, KNOWN)
    assert visited(found, network) == ["AB"]
    assert found.standing.sum() >= n
    assert np.ptp(found.offset[found.standing]) == 0.0


def test_one_wild_position_does_not_break_the_track() -> None:
    network, track = draw("A-0-1-2-3-4-5-6-7-8-9-B")
    y = track.floats("y").copy()
    y[5] += 60.0
    found = match(track.with_columns(y=y), network, KNOWN)
    assert REASONS[found.reason[5]] == "position out of line"
    assert (np.delete(found.edge, 5) == network.edge("AB")).all()
    assert not found.restart.any()


def test_rows_without_a_position_say_so() -> None:
    network, track = draw("A-0-1-2-3-B")
    x = track.floats("x").copy()
    x[1] = np.nan
    found = match(track.with_columns(x=x), network, KNOWN)
    assert names(found, network) == ["AB", "no position", "AB", "AB"]


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_the_shortest_tracks(rows: int) -> None:
    network, track = draw("A-0-1-2-3-B")
    found = match(track[:rows], network)
    assert len(found) == rows and (found.edge >= 0).all()
