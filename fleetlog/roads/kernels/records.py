"""What the loops of the matcher share: arrays that belong together."""

from typing import NamedTuple

from fleetlog.core.arrays import Floats, Index, Ints, Mask

Wide = Ints


class Roads(NamedTuple):
    """The E edges of a network."""

    length: Floats  # (E,) [m]
    reverse: Index  # (E,) an edge's other direction, -1 without
    next_first: Index  # (E + 1,): edge e may be followed by next_edges[next_first[e]:next_first[e + 1]]
    next_edges: Index
    rank: Wide  # (E,) the order in which equal alternatives are taken


class Lines(NamedTuple):
    """Their P vertices; each begins the piece of line to the next."""

    first: Wide  # (E + 1,): edge e owns vertices first[e]:first[e + 1]
    owner: Index  # (P,) the edge of a vertex
    x: Floats  # (P,) [m]
    y: Floats
    along: Floats  # (P,) along its edge [m]
    flat: Floats  # (P,) length of the piece on the plan [m]
    ux: Floats  # (P,) its unit vector there
    uy: Floats
    stretch: Floats  # (P,) metres along per metre of plan: offsets may count the climb too (3-D length)
    twin: Index  # (E,) an edge's other direction where it is the very same line, else -1


class Grid(NamedTuple):
    """Square cells of a plane, column after column."""

    x0: float  # origin [m]
    y0: float
    cell: float  # side [m]
    nx: int
    ny: int
    starts: Wide  # of cell c the segments items[starts[c]:starts[c + 1]]
    items: Wide


class Candidates(NamedTuple):
    """The C edges near every group: those of group g are rows ptr[g]:ptr[g + 1]."""

    ptr: Wide  # (G + 1,)
    edge: Index  # (C,)
    offset: Floats  # (C,) [m]
    lateral: Floats  # (C,) distance, left positive [m]
    ux: Floats  # (C,) tangent
    uy: Floats


class Store(NamedTuple):
    """Distances found so far, and the scratch arrays of the search."""

    known: Floats  # (E,) bound up to which an edge's reach is stored, -1: not at all [m]
    begin: Wide  # (E,) its first row in the three below
    reached: Wide  # (E,) how many rows
    target: Index
    previous: Index
    away: Floats
    used: Wide  # (1,) how many rows are taken
    best: Floats
    before: Index
    heap_d: Floats
    heap_e: Index
    found: Index


class Track(NamedTuple):
    """N rows with a position."""

    t: Floats  # [s]
    x: Floats  # [m]
    y: Floats
    speed: Floats  # of the log [m/s], NaN unknown
    heading: Floats  # of the log [rad], NaN unknown
    chain: Wide  # counts up at gaps
    interval: float  # usual time between rows [s]


class Groups(NamedTuple):
    """G groups of rows."""

    first: Wide  # (G + 1,) first rows
    t: Floats  # mean time [s]
    x: Floats  # mean place [m]
    y: Floats
    moved: Floats  # travelled distance to the next [m]
    axis: Floats  # (2, G) unit vector of twice the log's heading, weighted by its strength; 0 without
    still: Mask
    chain: Wide


class Choice(NamedTuple):
    """What is decided about G groups and their C candidates."""

    chosen: Wide  # (G,) candidate, -1 off the roads
    posterior: Floats  # (C + G,) of the states: of each group's candidates and of being off the roads
    linked: Mask  # (G,) whether the step into a group is connected to the group before


class Routes(NamedTuple):
    """P pieces of S stretches, end to end."""

    edge: Index  # (P,)
    begin: Floats  # (P,) offsets on the edge [m]
    end: Floats
    place: Floats  # (P,) path coordinate of the begin [m]
    firsts: Wide  # (S + 1,) first pieces
    spans: Wide  # (2, S) first and last group
    of: Wide  # (G,) stretch of every group, -1 off the roads
    piece: Wide  # (G,) and its piece
    centre: Floats  # (G,) and path coordinate [m]


class Rows(NamedTuple):
    """N rows to be placed, and what is known of them on the way."""

    t: Floats  # [s]
    x: Floats  # [m]
    y: Floats
    speed: Floats  # [m/s], NaN unknown, 0 where it stands
    still: Mask
    centre: Floats  # path coordinate of its group [m]
    near: Floats  # posterior of the route about its group
    position_var: Floats  # [m2]
    speed_var: Floats  # [m2/s2]
    where: Floats  # path coordinate [m], interpolated between the groups at first
    sd: Floats  # [m]
    seen: Floats  # coordinate of the position [m]
    kept: Floats  # (5, N) states of the filter; then pools of :func:`make_monotone`
