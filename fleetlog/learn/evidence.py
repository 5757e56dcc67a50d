"""How often which road was driven, by whom, on which days, how fast: passes of a recording over a network."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory
from fleetlog.roads.matching import Match, match
from fleetlog.roads.routing import Router

Floats = NDArray[np.float64]
WHOLE = 0.6
"""A visit that drives this share of an edge is a pass."""
LONGEST, SLACK = 3.0, 20.0
"""No way is filled in between rows that is longer than this many times the straight line, plus this [m]."""
STEADY = 0.3
"""A truck slower than this stands or manoeuvres [m/s]."""


@dataclass
class Evidence:
    """What a recording says of the E edges of a network.

    ``passes`` visits of a whole edge; ``metres`` driven on it in all; ``speeds`` on it, a histogram of 0.1
    m/s; ``turns`` from edge to edge; ``vehicles`` and ``days`` by edge; ``rows`` in all and ``matched``.
    """

    passes: NDArray[np.int64]
    metres: Floats
    speeds: NDArray[np.int64]
    turns: Counter[tuple[int, int]] = field(default_factory=Counter)
    vehicles: dict[int, set[str]] = field(default_factory=dict)
    days: dict[int, set[int]] = field(default_factory=dict)
    rows: int = 0
    matched: int = 0

    def mean_passes(self, network: Network) -> NDArray[np.int64]:
        """(E,) how often each metre of an edge was driven on average."""
        return np.round(self.metres / network.length).astype(np.int64)


SPEED_STEP, SPEED_BINS = 0.1, 400


def gather_evidence(network: Network, trajectories: Iterable[Trajectory]) -> Evidence:
    """Match every trajectory and count; the network's turns bound what can be driven."""
    n = len(network)
    found = Evidence(np.zeros(n, np.int64), np.zeros(n), np.zeros((n, SPEED_BINS), np.int64))
    router = Router(network, speed=np.ones(n))
    for t in trajectories:
        matched = match(t, network)
        _count_speeds(found, matched, t.floats("speed"))
        for run in _runs(matched, network.length):
            _count_run(found, _filled(run, matched, t, router), network, t)
    return found


def _count_speeds(found: Evidence, m: Match, speed: Floats) -> None:
    use = (m.edge >= 0) & ~m.standing & (speed > STEADY)
    step = np.minimum(speed[use] / SPEED_STEP, SPEED_BINS - 1).astype(np.int64)
    np.add.at(found.speeds, (m.edge[use], step), 1)
    found.rows += len(m)
    found.matched += int((m.edge >= 0).sum())


def _runs(m: Match, length: Floats) -> Iterator[NDArray[np.int64]]:
    """First rows of the visits of every unbroken run of rows on the roads."""
    on = np.flatnonzero(m.edge >= 0)
    if not len(on):
        return
    fresh = np.ones(len(on), bool)
    fresh[1:] = (np.diff(on) > 1) | (m.restart[on[1:]] > 0)
    change = fresh.copy()
    change[1:] |= m.edge[on[1:]] != m.edge[on[:-1]]
    # a ring of one edge, driven once more
    change[1:] |= np.diff(m.offset[on]) < -0.5 * length[m.edge[on[1:]]]
    run = np.cumsum(fresh)[change]
    yield from np.split(on[change], np.flatnonzero(np.diff(run)) + 1)


@dataclass(frozen=True)
class Visit:
    """A stay on an edge between two offsets [m]."""

    edge: int
    begin: float
    end: float
    row: int


def _filled(run: NDArray[np.int64], m: Match, t: Trajectory, router: Router) -> list[list[Visit]]:
    """The visits of a run, with the edges between two rows filled in; a new list where no way is known."""
    x, y, length = t.floats("x"), t.floats("y"), router.network.length
    out: list[list[Visit]] = [[]]
    begin = float(m.offset[run[0]])
    for row, after in pairwise(run.tolist()):
        edge, ahead, until = int(m.edge[row]), int(m.edge[after]), after - 1
        offset, onward = float(m.offset[until]), float(m.offset[after])
        if ahead == router.network.reverse[edge]:
            turned = max(offset, float(length[edge]) - onward)
            out[-1].append(Visit(edge, begin, turned, row))
            begin = float(length[edge]) - turned
            continue
        straight = float(np.hypot(x[after] - x[until], y[after] - y[until]))
        way = _way(router, edge, ahead, LONGEST * straight + SLACK)
        if way is None:
            out[-1].append(Visit(edge, begin, offset, row))
            out.append([])
            begin = onward
        else:
            out[-1].append(Visit(edge, begin, float(length[edge]), row))
            out[-1] += [Visit(e, 0.0, float(length[e]), row) for e in way]
            begin = 0.0
    row = int(run[-1])
    out[-1].append(Visit(int(m.edge[row]), begin, float(m.offset[_last_row(m, row)]), row))
    return out


def _last_row(m: Match, row: int) -> int:
    """The last row of the visit that begins at ``row``."""
    while row + 1 < len(m) and m.edge[row + 1] == m.edge[row] and not m.restart[row + 1]:
        row += 1
    return row


def _way(router: Router, edge: int, ahead: int, longest: float) -> list[int] | None:
    """The edges between two, [] where one follows the other, None where there is none so short [m]."""
    if ahead in router.network.successors(edge):
        return []
    route = router.route(edge, ahead)
    if route is None or float(router.network.length[route.edges[1:-1]].sum()) > longest:
        return None
    return [int(e) for e in route.edges[1:-1]]


def _count_run(found: Evidence, pieces: list[list[Visit]], network: Network, t: Trajectory) -> None:
    for visits in pieces:
        for v in visits:
            found.metres[v.edge] += max(v.end - v.begin, 0.0)
            found.passes[v.edge] += v.end - v.begin >= WHOLE * network.length[v.edge]
            found.vehicles.setdefault(v.edge, set()).add(t.vehicle_id)
            found.days.setdefault(v.edge, set()).add(int(t.time[v.row] // 86_400_000_000))
        for a, b in pairwise(visits):
            found.turns[a.edge, b.edge] += 1
