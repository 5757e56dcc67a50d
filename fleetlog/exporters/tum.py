"""TUM trajectory of one vehicle: ``timestamp x y z qx qy qz qw``, as evo reads it."""

from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.exporters.base import Selection


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Metres in the site frame; an unknown height or heading is written as 0, as the format has no null."""
    vehicle = selection.need_one_vehicle("TUM")
    with path.open("w", encoding="ascii") as out:
        out.write("# timestamp x y z qx qy qz qw\n")
        for t in map(selection.placed, selection.days(["x", "y", "z", "heading"])):
            z, half = np.nan_to_num(t.floats("z")), np.nan_to_num(t.floats("heading")) / 2.0
            columns = (t.time, t.floats("x"), t.floats("y"), z, np.sin(half), np.cos(half))
            for time, x, y, up, s, c in zip(*(v.tolist() for v in columns), strict=True):
                stamp = f"{time // 1_000_000}.{time % 1_000_000:06d}"
                out.write(f"{stamp} {x:.6f} {y:.6f} {up:.6f} 0 0 {s:.9f} {c:.9f}\n")
    return {"vehicle": vehicle}
