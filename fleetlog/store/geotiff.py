"""A grid of a result as a GeoTIFF: 32-bit floats, NaN where empty, placed on the earth.

TIFF 6.0 with one compressed strip, and the tags of OGC GeoTIFF 1.1 (OGC 19-008r4): azimuthal equidistant
metres about the site's origin; a turned site by a full transformation.  Without a frame the raster lies in
local metres.
"""

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fleetlog.core.result import Grid
from fleetlog.core.site import Frame

SHORT, LONG, DOUBLE, ASCII = 3, 4, 12, 2
_FORMATS = {SHORT: "H", LONG: "I", DOUBLE: "d"}
Tag = tuple[int, int, int, bytes]


def write_geotiff(grid: Grid, path: str | Path, frame: Frame | None = None) -> None:
    """The values as band 1, north up; a mask, where there is one, as band 2 (1 inside, 0 outside)."""
    bands = [grid.values, *([] if grid.mask is None else [grid.mask])]
    pixels = np.stack([np.asarray(b, dtype="<f4")[::-1] for b in bands], axis=-1)
    data = zlib.compress(np.ascontiguousarray(pixels).tobytes(), 6)
    rows, columns, samples = pixels.shape
    tags = [
        _tag(256, LONG, columns), _tag(257, LONG, rows), _tag(258, SHORT, *[32] * samples),
        _tag(259, SHORT, 8), _tag(262, SHORT, 1), _text(270, f"{grid.name}: {grid.label}"),
        _tag(273, LONG, 8), _tag(277, SHORT, samples), _tag(278, LONG, rows), _tag(279, LONG, len(data)),
        _tag(284, SHORT, 1), *([_tag(338, SHORT, *[0] * (samples - 1))] if samples > 1 else []),
        _tag(339, SHORT, *[3] * samples), *_placing(grid, frame), *_system(frame), _text(42113, "nan"),
    ]  # fmt: skip
    body = data + b"\0" * (len(data) % 2)
    directory = _directory(sorted(tags), 8 + len(body))
    Path(path).write_bytes(b"II*\0" + struct.pack("<I", 8 + len(body)) + body + directory)


def _tag(number: int, kind: int, *values: float) -> Tag:
    return number, kind, len(values), struct.pack(f"<{len(values)}{_FORMATS[kind]}", *values)


def _text(number: int, text: str) -> Tag:
    raw = text.encode("utf-8") + b"\0"
    return number, ASCII, len(raw), raw


def _directory(tags: list[Tag], at: int) -> bytes:
    """The table of tags, which begins at byte ``at``, and behind it the values that do not fit into it."""
    behind = at + 2 + 12 * len(tags) + 4
    table, extra = struct.pack("<H", len(tags)), b""
    for number, kind, count, raw in tags:
        value = raw.ljust(4, b"\0")
        if len(raw) > 4:
            value = struct.pack("<I", behind + len(extra))
            extra += raw + b"\0" * (len(raw) % 2)
        table += struct.pack("<HHI", number, kind, count) + value
    return table + struct.pack("<I", 0) + extra


def transformation(grid: Grid, rotation: float = 0.0) -> NDArray[np.float64]:
    """(2, 3) from (column, row, 1), from the north-west corner, to metres east and north of the origin."""
    c, s = np.cos(rotation), np.sin(rotation)
    top = grid.y0 + len(grid.values) * grid.cell
    turn = np.array([[c, -s], [s, c]])
    return np.asarray(turn @ np.array([[grid.cell, 0.0, grid.x0], [0.0, -grid.cell, top]]), dtype=np.float64)


def _placing(grid: Grid, frame: Frame | None) -> list[Tag]:
    rotation = 0.0 if frame is None else frame.rotation
    (a, b, x), (d, e, y) = transformation(grid, rotation)
    if rotation == 0.0:
        return [_tag(33550, DOUBLE, a, -e, 0.0), _tag(33922, DOUBLE, 0.0, 0.0, 0.0, x, y, 0.0)]
    return [_tag(34264, DOUBLE, a, b, 0.0, x, d, e, 0.0, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)]


def _system(frame: Frame | None) -> list[Tag]:
    """Azimuthal equidistant (12) metres (9001) on WGS 84 (4326), or a model of the user's own (32767)."""
    if frame is None:
        return [_tag(34735, SHORT, 1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1)]
    keys = [
        (1024, 0, 1, 1), (1025, 0, 1, 1), (2048, 0, 1, 4326), (3072, 0, 1, 32767), (3074, 0, 1, 32767),
        (3075, 0, 1, 12), (3076, 0, 1, 9001), (3082, 34736, 1, 0), (3083, 34736, 1, 0), (3088, 34736, 1, 1),
        (3089, 34736, 1, 2),
    ]  # fmt: skip
    flat = [v for key in [(1, 1, 0, len(keys)), *keys] for v in key]
    return [_tag(34735, SHORT, *flat), _tag(34736, DOUBLE, 0.0, frame.longitude, frame.latitude)]
