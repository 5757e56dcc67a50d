"""KITTI poses: twelve numbers a line, the first three rows of a pose; seconds in ``times.txt`` beside it.

Axes are those of the export: x, y on the floor and z up.
"""

import math
from collections.abc import Iterator
from pathlib import Path

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes
from fleetlog.importers._rows import Rows, figures, gather, mostly
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

LINE_LIMIT = 4096
TIMES = "times.txt"


def _pose(line: bytes) -> list[float] | None:
    """The numbers of a line whose first column of the rotation has length one."""
    n = figures(line, 12)
    return n if n and abs(math.hypot(n[0], n[4], n[8]) - 1.0) < 0.05 else None


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a line; the heading is the yaw of the rotation."""
    stream, raw = open_bytes(path, options.report)
    beside = path.parent / TIMES
    if not beside.is_file():
        stream.close()
        do = f"put the seconds beside it, one a line, as {TIMES}"
        raise FormatError("KITTI poses have no times of their own", where=path, do=do)
    clock, _ = open_bytes(beside, options.report)
    rows = Rows("x", "y", share=lambda: raw.share)

    def take(line: bytes, number: int) -> None:
        _add(rows, options, line, clock.readline(LINE_LIMIT), number)

    with stream, clock:
        yield from gather(iter(lambda: stream.readline(LINE_LIMIT), b""), take, rows)
    if not rows.total:
        raise options.report.nothing("no line is a pose of twelve numbers with a time")
    since = " since the profile's origin" if options.origin else ""
    options.report.recognised |= {
        "pose": "x, y, z from m, heading, the yaw of the rotation", TIMES: f"timestamp, from s{since}",
    }  # fmt: skip
    yield from rows.drain()


def _add(rows: Rows, options: ReadOptions, line: bytes, stamp: bytes, number: int) -> None:
    pose = _pose(line)
    if pose is None:
        rows.reject(number, "not twelve numbers with a rotation", line.decode("latin-1").strip())
        return
    try:
        time = options.origin + round(float(stamp) * 1e6)
    except (ValueError, OverflowError):
        rows.reject(number, f"no time in {TIMES}", stamp.decode("latin-1").strip())
        return
    values = {"x": pose[3], "y": pose[7], "z": pose[11], "heading": math.atan2(pose[4], pose[0])}
    rows.add(options.name, time, number, values)


IMPORTER = Importer("kitti", (".txt", ".kitti"), mostly(_pose), read, rank=5)
