"""What the loops of the matcher share: arrays that belong together."""

from typing import NamedTuple

from fleetlog.core.arrays import Floats, Index, Ints, Mask

Wide = Ints


class Roads(NamedTuple):
    """A network of E edges and P vertices."""

    px: Floats  # (P,) [m]
    py: Floats
    first: Wide  # (E + 1,): edge e owns vertices first[e]:first[e + 1]
    dist: Floats  # (P,) along its edge [m]
    owner: Index  # (P,) the edge of a vertex
    length: Floats  # (E,) [m]
    reverse: Index  # (E,) an edge's other direction, -1 without
    twin: Index  # (E,) that where it is the very same line, else -1
    next_first: Index  # (E + 1,): edge e may be followed by next_edges[next_first[e]:next_first[e + 1]]
    next_edges: Index
    rank: Wide  # (E,) the order in which equal alternatives are taken


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
    value: Floats  # (4, C) offset and lateral distance [m] (left positive), tangent x and y


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


class Costs(NamedTuple):
    """The model."""

    beta: float  # spread of steps [m]
    back: float  # how far noise moves a truck against its edge [m]
    turn: float  # cost of a turn in mid edge


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
    value: Floats  # (3, P) from, to (offsets on the edge), coordinate of the begin [m]
    firsts: Wide  # (S + 1,) first pieces
    spans: Wide  # (2, S) first and last group
    of: Wide  # (G,) stretch of every group
    piece: Wide  # (G,) and its piece
    place: Floats  # (G,) and path coordinate (-1 off the roads) [m]


class Noise(NamedTuple):
    """Variances and the like."""

    position: float  # of a position [m2]
    lasting: float  # of errors that last from group to group [m2]
    speed: float  # of the log's speed [m2/s2]
    acceleration: float  # density along the route [m2/s3]


class Placed(NamedTuple):
    """Where each of N rows is."""

    edge: Index
    offset: Floats  # [m]
    lateral: Floats  # [m]
    confidence: Floats
