"""How often which road was driven, by whom, on which days, how fast: passes of a recording over a network."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from fleetlog.core.arrays import Floats, Ints
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads.matching import Match, match
from fleetlog.roads.routing import Router

WHOLE = 0.6  # a visit that drives this share of an edge is a pass
LONGEST, SLACK = 3.0, 20.0  # a way between rows is no longer than 3 times the straight line, plus 20 m
STEADY = 0.3  # a truck slower than this stands or manoeuvres [m/s]


Visit = tuple[int, float, float, int]
"""An edge, from and to [m] on it, and the first row."""


@dataclass
class Evidence:
    """What a recording says of the E edges of a network."""

    passes: Ints  # (E,) visits of a whole edge
    metres: Floats  # (E,) driven on it in all
    speeds: Ints  # (E, bins) on it, a histogram of 0.1 m/s
    turns: Counter[tuple[int, int]] = field(default_factory=Counter)
    vehicles: dict[int, set[str]] = field(default_factory=dict)
    days: dict[int, set[int]] = field(default_factory=dict)
    rows: int = 0
    matched: int = 0

    def mean_passes(self, network: Network) -> Ints:
        """(E,) how often each metre of an edge was driven on average."""
        return np.round(self.metres / network.length).astype(np.int64)


SPEED_STEP, SPEED_BINS = 0.1, 400


def gather_evidence(network: Network, trajectories: Iterable[Trajectory]) -> Evidence:
    """Match every trajectory and count; the network's turns bound what can be driven."""
    n = len(network)
    found = Evidence(np.zeros(n, np.int64), np.zeros(n), np.zeros((n, SPEED_BINS), np.int64))
    router = Router(network, speed=np.ones(n))
    for t in trajectories:
        m, speed = match(t, network), t.floats("speed")
        use = (m.edge >= 0) & ~m.standing & (speed > STEADY)
        step = np.minimum(speed[use] / SPEED_STEP, SPEED_BINS - 1).astype(np.int64)
        np.add.at(found.speeds, (m.edge[use], step), 1)
        found.rows += len(m)
        found.matched += int((m.edge >= 0).sum())
        for visits in (chain for run in _runs(m, network.length) for chain in _visits(run, m, t, router)):
            found.turns.update(pairwise(edge for edge, *_ in visits))
            for edge, begin, end, row in visits:
                found.metres[edge] += max(end - begin, 0.0)
                found.passes[edge] += end - begin >= WHOLE * network.length[edge]
                found.vehicles.setdefault(edge, set()).add(t.vehicle_id)
                found.days.setdefault(edge, set()).add(int(t.time[row] // 86_400_000_000))
    return found


def _runs(m: Match, length: Floats) -> Iterator[list[int]]:
    """First rows of the visits of every unbroken run of rows on the roads, and the row after the last."""
    on = np.flatnonzero(m.edge >= 0)
    fresh = np.append(True, (np.diff(on) > 1) | (m.restart[on[1:]] > 0))
    change = fresh.copy()
    change[1:] |= m.edge[on[1:]] != m.edge[on[:-1]]
    # a ring of one edge, driven once more
    change[1:] |= np.diff(m.offset[on]) < -0.5 * length[m.edge[on[1:]]]
    for run in np.split(np.arange(len(on)), np.flatnonzero(fresh)[1:]) if len(on) else ():
        yield [*on[run[change[run]]].tolist(), int(on[run[-1]]) + 1]


def _visits(bounds: list[int], m: Match, t: Trajectory, router: Router) -> list[list[Visit]]:
    """The visits of a run, parted where the way between two is not known.

    Edges that are driven between two rows are visits too.
    """
    x, y = t.floats("x"), t.floats("y")
    length, begin = router.network.length.tolist(), float(m.offset[bounds[0]])
    out: list[list[Visit]] = [[]]
    for row, after in pairwise(bounds[:-1]):
        edge, end = int(m.edge[row]), float(m.offset[after - 1])
        ahead, onward = int(m.edge[after]), float(m.offset[after])
        straight = float(np.hypot(x[after] - x[after - 1], y[after] - y[after - 1]))
        if ahead == router.network.reverse[edge]:
            turned = max(end, length[edge] - onward)
            out[-1].append((edge, begin, turned, row))
            begin = length[edge] - turned
        elif (way := _way(router, edge, ahead, LONGEST * straight + SLACK)) is None:
            out[-1].append((edge, begin, end, row))
            out.append([])
            begin = onward
        else:
            out[-1] += [(edge, begin, length[edge], row), *((e, 0.0, length[e], row) for e in way)]
            begin = 0.0
    row, after = bounds[-2:]
    out[-1].append((int(m.edge[row]), begin, float(m.offset[after - 1]), row))
    return out


def _way(router: Router, edge: int, ahead: int, longest: float) -> list[int] | None:
    """The edges between two, [] where one follows the other, None where there is none so short [m]."""
    if ahead in router.network.successors(edge):
        return []
    route = router.route(edge, ahead)
    between = [] if route is None else route.edges[1:-1].tolist()
    return None if route is None or router.network.length[between].sum() > longest else between
