"""The search for one route, compiled.  Ties are broken by edge number, so one input has one answer."""

from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from fleetlog.compiling import kernel
from fleetlog.roads.kernels.records import Floats, Index


@kernel()
def astar(
    next_first: Index, next_edges: Index, cost: Floats, turn_cost: Floats, closed: NDArray[np.bool_],
    bound: Floats, source: np.int32, target: np.int32,
) -> tuple[Index, Floats]:  # fmt: skip
    """Cheapest chain of edges from ``source`` to ``target``, empty if none; and the cost at each.

    ``cost[i]`` is that of driving all of edge i, ``turn_cost[k]`` that of the turn next_edges[k],
    ``bound[j]`` never more than the cost from the start of edge j to that of the target (consistent: the
    first arrival is the best).  Among equal costs the predecessor with the lower number wins.
    """
    edges = len(cost)
    best = np.full(edges, np.inf)
    came = np.full(edges, -1, dtype=np.int32)
    done = np.zeros(edges, dtype=np.bool_)
    best[source] = 0.0
    heap = [(bound[source], source)]
    while len(heap) > 0:
        _, i = heappop(heap)
        if done[i]:
            continue
        done[i] = True
        if i == target:
            break
        onward = best[i] + cost[i]
        for k in range(next_first[i], next_first[i + 1]):
            j = next_edges[k]
            if closed[j] or done[j]:
                continue
            there = onward + turn_cost[k]
            if there < best[j] or (there == best[j] and i < came[j]):
                best[j] = there
                came[j] = i
                heappush(heap, (there + bound[j], j))
    if not done[target]:
        return np.empty(0, dtype=np.int32), np.empty(0, dtype=np.float64)
    chain = [target]
    while chain[-1] != source:
        chain.append(came[chain[-1]])
    edges_of = np.array(chain[::-1], dtype=np.int32)
    return edges_of, best[edges_of]
