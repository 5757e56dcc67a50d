"""KITTI poses: twelve numbers a line, the first three rows of a pose, and the seconds in ``times.txt`` beside it.

Axes are those of the export: x, y on the floor and z up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes, plain_stem
from fleetlog.importers._rows import Rows
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

FIELDS = 12
LINE_LIMIT = 4096
TIMES = "times.txt"


def sniff(path: Path, head: bytes) -> bool:
    """Whether most of the first lines are twelve numbers each with a rotation in them."""
    lines = [s for s in head.split(b"\n")[:20] if s.strip()]
    return 2 * sum(_pose(line) is not None for line in lines) > len(lines)


def _pose(line: bytes) -> list[float] | None:
    """The numbers of a line whose first column of the rotation has length one."""
    cells = line.split()
    try:
        numbers = [float(c) for c in cells]
    except ValueError:
        return None
    if len(numbers) != FIELDS or not all(map(math.isfinite, numbers)):
        return None
    return numbers if abs(math.hypot(numbers[0], numbers[4], numbers[8]) - 1.0) < 0.05 else None


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
    vehicle = options.vehicle or plain_stem(path)
    number = 0
    with stream, clock:
        while line := stream.readline(LINE_LIMIT):
            number += 1
            rows.attempt(
                number, _add, rows, line, clock.readline(LINE_LIMIT), vehicle, number, options.origin
            )
            if rows.full:
                yield rows.take()
    if not rows.total:
        raise FormatError(
            "no line is a pose of twelve numbers with a time", where=path, do="check the format"
        )
    since = " since the profile's origin" if options.origin else ""
    options.report.recognised.update({
        "pose": "x, y, z from m, heading, the yaw of the rotation", TIMES: f"timestamp, from s{since}",
    })  # fmt: skip
    yield from rows.drain()


def _add(rows: Rows, line: bytes, stamp: bytes, vehicle: str, number: int, origin: int) -> None:
    pose = _pose(line)
    if pose is None:
        rows.reject(number, "not twelve numbers with a rotation", line.decode("latin-1").strip())
        return
    try:
        time = origin + round(float(stamp) * 1e6)
    except (ValueError, OverflowError):
        rows.reject(number, f"no time in {TIMES}", stamp.decode("latin-1").strip())
        return
    values = {"x": pose[3], "y": pose[7], "z": pose[11], "heading": math.atan2(pose[4], pose[0])}
    rows.add(vehicle, time, number, values)


IMPORTER = Importer("kitti", (".txt", ".kitti"), sniff, read, rank=5)
