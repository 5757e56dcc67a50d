"""KITTI odometry poses of one vehicle: the first three rows of a 4 x 4 pose a line, without times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.exporters.base import Exporter, Selection


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Rotation about z by the heading; an unknown height or heading is written as 0."""
    vehicle = selection.need_one_vehicle("KITTI")
    rows = left_out = 0
    with path.open("w", encoding="ascii") as out:
        for t in selection.days(["x", "y", "z", "heading"]):
            x, y = t.floats("x"), t.floats("y")
            z, yaw = np.nan_to_num(t.floats("z")), np.nan_to_num(t.floats("heading"))
            good = np.isfinite(x) & np.isfinite(y)
            left_out += int((~good).sum())
            zero, one = np.zeros(len(t)), np.ones(len(t))
            c, s = np.cos(yaw), np.sin(yaw)
            poses = np.column_stack([c, -s, zero, x, s, c, zero, y, zero, zero, one, z])[good]
            np.savetxt(out, poses, fmt="%.9g")
            rows += len(poses)
    return {"rows": rows, "rows_without_position": left_out, "vehicle": vehicle}


EXPORTER = Exporter("kitti", ".txt", "KITTI poses of one vehicle, without times", write)
