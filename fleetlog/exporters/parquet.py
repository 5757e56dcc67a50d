"""One Parquet file; GeoParquet 1.1 (a WGS 84 point a row) where the site has a place on earth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleetlog.exporters.base import Selection

_GEO = {
    "version": "1.1.0", "primary_column": "geometry",
    "columns": {"geometry": {"encoding": "WKB", "geometry_types": ["Point"], "edges": "spherical"}},
}  # fmt: skip
_WKB_POINT = np.dtype([("order", "u1"), ("kind", "<u4"), ("x", "<f8"), ("y", "<f8")])


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """The columns of the contract, vehicle by vehicle, and ``geometry``."""
    schema = selection.schema()
    whole, frame = schema, selection.dataset.site.frame
    if frame is not None:
        whole = schema.append(pa.field("geometry", pa.binary())).with_metadata({"geo": json.dumps(_GEO)})
    with pq.ParquetWriter(path, whole, compression="zstd") as writer:
        for table in selection.tables(schema):
            if frame is not None:
                # Well-known binary of every position; null where it is unknown.
                x, y = (table.column(c).to_numpy().astype(np.float64) for c in ("x", "y"))
                latitude, longitude = frame.to_geographic(x, y)
                wkb = np.zeros(len(table), _WKB_POINT)
                wkb["order"], wkb["kind"], wkb["x"], wkb["y"] = 1, 1, longitude, latitude
                known = np.packbits(np.isfinite(x) & np.isfinite(y), bitorder="little")
                buffers = [pa.py_buffer(known.tobytes()), pa.py_buffer(wkb.tobytes())]
                fixed = pa.binary(_WKB_POINT.itemsize)
                points = pa.FixedSizeBinaryArray.from_buffers(fixed, len(table), buffers).cast(pa.binary())
                table = table.append_column("geometry", points).cast(whole)
            writer.write_table(table)
    return {"geometry": frame is not None}
