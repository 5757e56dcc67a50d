"""TUM trajectory of one vehicle: ``timestamp x y z qx qy qz qw``, as evo reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.exporters.base import Exporter, Selection


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Metres in the site frame; an unknown height or heading is written as 0, as the format has no null."""
    vehicle = selection.need_one_vehicle("TUM")
    rows = left_out = 0
    with path.open("w", encoding="ascii") as out:
        out.write("# timestamp x y z qx qy qz qw\n")
        for t in selection.days(["x", "y", "z", "heading"]):
            x, y = t.floats("x"), t.floats("y")
            z, half = np.nan_to_num(t.floats("z")), np.nan_to_num(t.floats("heading")) / 2.0
            good = np.isfinite(x) & np.isfinite(y)
            left_out += int((~good).sum())
            columns = (c[good].tolist() for c in (t.time, x, y, z, np.sin(half), np.cos(half)))
            for time, a, b, up, s, c in zip(*columns, strict=True):
                stamp = f"{time // 1_000_000}.{time % 1_000_000:06d}"
                out.write(f"{stamp} {a:.6f} {b:.6f} {up:.6f} 0 0 {s:.9f} {c:.9f}\n")
            rows += int(good.sum())
    return {"rows": rows, "rows_without_position": left_out, "vehicle": vehicle}


EXPORTER = Exporter("tum", ".tum", "TUM trajectory of one vehicle, for evo", write)
