"""What the loops of the matcher share: arrays that belong together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Wide = NDArray[np.int64]
Index = NDArray[np.int32]
Flags = NDArray[np.bool_]


class Roads(NamedTuple):
    """A network: edge e owns vertices first[e]:first[e + 1], ``dist`` [m] along it, and may be followed by
    next_edges[next_first[e]:next_first[e + 1]].

    ``owner`` is the edge of a vertex, ``reverse`` an edge's other direction, ``twin`` that where it is the
    very same line (-1: none), ``rank`` the order in which equal alternatives are taken.
    """

    px: Floats
    py: Floats
    first: Wide
    dist: Floats
    owner: Index
    length: Floats
    reverse: Index
    twin: Index
    next_first: Index
    next_edges: Index
    rank: Wide


class Grid(NamedTuple):
    """Cells of a plane, column after column; of cell c the segments items[starts[c]:starts[c + 1]]."""

    x0: float
    y0: float
    cell: float
    nx: int
    ny: int
    starts: Wide
    items: Wide


class Candidates(NamedTuple):
    """The edges near every group g: rows ptr[g]:ptr[g + 1] of ``edge`` (C,) and ``value`` (4, C).

    ``value`` is offset and lateral distance [m] (left positive), tangent x and y.
    """

    ptr: Wide
    edge: Index
    value: Floats


class Store(NamedTuple):
    """Distances found so far, and the scratch arrays of the search.

    ``known`` (E,) is the bound up to which an edge's reach is stored (-1: not at all), ``begin`` and
    ``reached`` its rows in ``target``, ``previous`` and ``away``; ``used`` (1,) is how many rows are taken.
    """

    known: Floats
    begin: Wide
    reached: Wide
    target: Index
    previous: Index
    away: Floats
    used: Wide
    best: Floats
    before: Index
    heap_d: Floats
    heap_e: Index
    found: Index


class Costs(NamedTuple):
    """The model: spread of steps ``beta`` and how far noise moves a truck ``back`` against its edge [m].

    ``turn`` is the cost of a turn in mid edge, ``off`` that of a group off the roads.
    """

    beta: float
    back: float
    turn: float
    off: float


class Track(NamedTuple):
    """Rows with a position: s, m, speed [m/s] and heading [rad] of the log (NaN unknown), chain (gaps)."""

    t: Floats
    x: Floats
    y: Floats
    speed: Floats
    heading: Floats
    chain: Wide


class Groups(NamedTuple):
    """G groups: first row of each (G + 1,), mean time, place, travelled distance to the next, heading's axis.

    ``axis`` (2, G) is the strength-weighted unit vector of the double angle; 0 where the log has no heading.
    """

    first: Wide
    t: Floats
    x: Floats
    y: Floats
    moved: Floats
    axis: Floats
    still: Flags
    chain: Wide


class Choice(NamedTuple):
    """(G,) the chosen candidate (-1 off the roads), (C,) posteriors of the candidates, (G,) that of being
    off, and (G,) whether the step into a group is connected to the group before.
    """

    chosen: Wide
    posterior: Floats
    off: Floats
    linked: Flags


class Routes(NamedTuple):
    """Pieces of all stretches, end to end.

    (P,) ``edge`` and (3, P) ``value``: from, to (offsets on it), coordinate of its begin; (S + 1,) ``firsts``
    pieces and (2, S) ``spans`` of groups of every stretch; (G,) stretch ``of``, ``piece`` and path coordinate
    ``place`` of every group (-1 off the roads).
    """

    edge: Index
    value: Floats
    firsts: Wide
    spans: Wide
    of: Wide
    piece: Wide
    place: Floats


class Noise(NamedTuple):
    """Variances of a position, of errors that last from group to group [m2] and of the log's speed [m2/s2];
    density of the acceleration along the route [m2/s3].
    """

    position: float
    lasting: float
    speed: float
    acceleration: float


class Placed(NamedTuple):
    """(N,) where each row is: edge, offset, lateral offset [m] and confidence."""

    edge: Index
    offset: Floats
    lateral: Floats
    confidence: Floats
