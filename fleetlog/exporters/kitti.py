"""KITTI odometry poses of one vehicle: three rows of a 4 x 4 pose a line; seconds in ``times.txt``."""

from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.exporters.base import Selection


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Rotation about z by the heading; an unknown height or heading is written as 0."""
    vehicle = selection.need_one_vehicle("KITTI")
    second = selection.beside("times.txt")
    with path.open("w", encoding="ascii") as out, second.open("w", encoding="ascii") as times:
        for t in map(selection.placed, selection.days(["x", "y", "z", "heading"])):
            z, yaw = np.nan_to_num(t.floats("z")), np.nan_to_num(t.floats("heading"))
            zero, one, c, s = np.zeros(len(t)), np.ones(len(t)), np.cos(yaw), np.sin(yaw)
            rows = (c, -s, zero, t.floats("x")), (s, c, zero, t.floats("y")), (zero, zero, one, z)
            np.savetxt(out, np.column_stack([v for row in rows for v in row]), fmt="%.9g")
            times.writelines(f"{us // 1_000_000}.{us % 1_000_000:06d}\n" for us in t.time.tolist())
    return {"vehicle": vehicle}
