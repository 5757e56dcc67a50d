"""What holds in every simulation; calculations of their own, not the simulator's."""

import numpy as np
from simulated_sites import TRUCK

HALF = (TRUCK.chassis.length / 2, TRUCK.chassis.width / 2)


def corners(x, y, heading):
    """(..., 4, 2) corners of footprints."""
    out = []
    for u, v in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        a, b = u * HALF[0], v * HALF[1]
        out.append(
            np.stack(
                [
                    x + a * np.cos(heading) - b * np.sin(heading),
                    y + a * np.sin(heading) + b * np.cos(heading),
                ],
                -1,
            )
        )
    return np.stack(out, -2)


def overlap(a, b):
    """Whether two convex quadrilaterals (4, 2) share area."""
    for shape in (a, b):
        for k in range(4):
            edge = shape[(k + 1) % 4] - shape[k]
            axis = np.array([-edge[1], edge[0]])
            p, q = a @ axis, b @ axis
            if p.max() <= q.min() + 1e-9 or q.max() <= p.min() + 1e-9:
                return False
    return True


def overlaps(outcome):
    x, y, h = outcome.array("x"), outcome.array("y"), outcome.array("heading")
    boxes = corners(x, y, h)
    reach = 2 * np.hypot(*HALF)
    found = []
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            near = np.flatnonzero(np.hypot(x[i] - x[j], y[i] - y[j]) < reach)
            found += [(i, j, int(k)) for k in near if overlap(boxes[i, k], boxes[j, k])]
    return found


def steps(t):
    """(N - 1,) distance between rows [m]."""
    return np.hypot(np.diff(t.floats("x")), np.diff(t.floats("y")))


def keeps_the_laws(outcome, network, truck=TRUCK, interval=0.1, slack=1e-3):
    """Footprints apart; speed (within ``slack`` m/s), acceleration, direction as map and truck allow; no truck jumps."""
    assert not overlaps(outcome)
    limit = np.where(np.isfinite(network.speed_limit), network.speed_limit, np.inf)
    top = np.minimum(limit * truck.drive.speed_factor, truck.drive.max_speed)
    for t in outcome.tracks:
        assert (np.diff(t.time) > 0).all()
        speed, edge = t.floats("speed"), t.labels("edge_id").recode(network.index)
        assert (edge >= 0).all()
        assert (speed <= top[edge] + slack).all()
        a = np.diff(speed) / interval
        assert a.max(initial=0.0) <= truck.drive.max_acceleration + 0.02
        assert a.min(initial=0.0) >= -truck.drive.max_deceleration - 0.02
        assert (steps(t) <= 0.5 * (speed[:-1] + speed[1:]) * interval + 0.03).all(), "no truck jumps"
        against_traffic(t, network, edge)


def against_traffic(t, network, edge):
    """The heading of motion is that of the directed edge; only out of a bay a truck backs, and no faster than it creeps there."""
    going = (t.floats("speed") > 1.05) & (np.abs(t.floats("lateral_offset")) < 1.2)
    inside = (t.floats("edge_offset") > 6.0) & (t.floats("edge_offset") < network.length[edge] - 6.0)
    rows = np.flatnonzero(going & inside)
    # A kink of the map's line is driven as a bend: there the heading lies between those of the line before and after it.
    ahead = np.array([network.heading(edge[rows], t.floats("edge_offset")[rows] + d) for d in range(-8, 9)])
    off = np.angle(np.exp(1j * (ahead - t.floats("heading")[rows])))
    assert ((off.min(axis=0) < 0.3) & (off.max(axis=0) > -0.3)).all()
