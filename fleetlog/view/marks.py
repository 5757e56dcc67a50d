"""Lines that are drawn for tasks, reservations and charging: pure array work."""

import numpy as np

from fleetlog.core.trajectory import Floats

POINTS, DASH = 25, 1.6
"""Points of an arc, and length of the dashes of a broken one [m]."""
RISE, LOWEST, HIGHEST = 0.16, 1.5, 11.0
"""Height of an arc over its span, and its bounds [m]."""
HEAD = 1.3
"""Length of an arrow's head [m]."""


def arc(start: Floats, end: Floats, points: int = POINTS) -> Floats:
    """(points, 3) from ``start`` to ``end`` ((3,) m), higher in the middle the farther they are apart."""
    share = np.linspace(0.0, 1.0, points)[:, None]
    height = np.clip(RISE * np.hypot(*(end - start)[:2]), LOWEST, HIGHEST)
    line = start + share * (end - start)
    line[:, 2:] += 4.0 * height * share * (1.0 - share)
    return np.asarray(line)


def head(line: Floats) -> Floats:
    """(3, 3) the arrow's head at the end of a line, lying as steep as the line comes down."""
    ahead = line[-1] - line[-2]
    length = float(np.linalg.norm(ahead))
    ahead = ahead / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    side = np.array([-ahead[1], ahead[0], 0.0]) / max(float(np.hypot(ahead[0], ahead[1])), 1e-9)
    back = line[-1] - HEAD * ahead
    return np.stack([back + 0.5 * HEAD * side, line[-1], back - 0.5 * HEAD * side])


def broken(start: Floats, end: Floats) -> list[Floats]:
    """The dashes of an arc; the last one reaches its end."""
    count = int(np.clip(np.hypot(*(end - start)[:2]) / (2.0 * DASH), 3, 40))
    line = arc(start, end, 2 * count + 2)
    return [line[k : k + 2] for k in range(0, len(line), 2)]


def ring(radius: float, height: float, corners: int = 28) -> Floats:
    """(corners + 1, 3) a circle about the origin."""
    turn = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(turn), height)])


def bolt(size: float, height: float) -> Floats:
    """(6, 3) a lightning bolt over the origin, leaning so that it is seen from above and from the south."""
    flat = np.array(
        [[0.1, 1.0], [-0.45, -0.1], [0.05, -0.05], [-0.1, -1.0], [0.45, 0.15], [-0.05, 0.1], [0.1, 1.0]]
    )
    lean = np.sqrt(0.5)
    return size * np.column_stack([flat[:, 0], lean * flat[:, 1], lean * flat[:, 1]]) + [0.0, 0.0, height]
