"""TUM trajectories: ``timestamp x y z qx qy qz qw`` a line, seconds and metres, as evo and SLAM tools write
them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes, plain_stem
from fleetlog.importers._rows import Rows, heading_of_quaternion
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

FIELDS = 8
LINE_LIMIT = 4096


def sniff(path: Path, head: bytes) -> bool:
    """Whether most of the first lines are eight numbers each, the last four a unit quaternion."""
    lines = [s for s in head.split(b"\n")[:20] if s.strip() and not s.lstrip().startswith(b"#")]
    return 2 * sum(_numbers(line) is not None for line in lines) > len(lines)


def _numbers(line: bytes) -> list[float] | None:
    """The eight numbers of a line, or None."""
    cells = line.replace(b",", b" ").split()
    if len(cells) != FIELDS:
        return None
    try:
        numbers = [float(c) for c in cells]
    except ValueError:
        return None
    if not all(map(math.isfinite, numbers)) or abs(math.hypot(*numbers[4:]) - 1.0) > 0.05:
        return None
    return numbers


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a line; the heading is the yaw of the quaternion."""
    stream, raw = open_bytes(path, options.report)
    vehicle = options.vehicle or plain_stem(path)
    rows = Rows("x", "y", share=lambda: raw.share)
    origin = options.origin
    number = 0
    with stream:
        while line := stream.readline(LINE_LIMIT):
            number += 1
            if not line.strip() or line.lstrip().startswith(b"#"):
                continue
            pose = _numbers(line)
            if pose is None or not -(1 << 62) < pose[0] * 1e6 < 1 << 62:
                rows.reject(
                    number, "not eight numbers ending in a unit quaternion", line.decode("latin-1").strip()
                )
            else:
                rows.attempt(number, _add, rows, vehicle, pose, line, number, origin)
            if rows.full:
                yield rows.take()
    if not rows.total:
        raise FormatError("no line reads 'timestamp x y z qx qy qz qw'", where=path, do="check the format")
    since = " since the profile's origin" if origin else ""
    options.report.recognised.update({
        "timestamp": f"timestamp, from s{since}", "x y z": "position in the site frame, from m",
        "qx qy qz qw": "heading, the yaw of the quaternion",
    })  # fmt: skip
    yield from rows.drain()


def _add(rows: Rows, vehicle: str, pose: list[float], line: bytes, number: int, origin: int) -> None:
    values = {"x": pose[1], "y": pose[2], "z": pose[3], "heading": heading_of_quaternion(*pose[4:])}
    rows.add(vehicle, origin + _microseconds(line.replace(b",", b" ").split()[0]), number, values)


def _microseconds(cell: bytes) -> int:
    """Exact where the stamp is a plain decimal: a double of seconds since 1970 only holds a quarter of a
    microsecond.
    """
    whole, _, fraction = cell.partition(b".")
    if whole.isdigit() and fraction.isdigit():
        return int(whole) * 1_000_000 + int(fraction[:6].ljust(6, b"0"))
    return round(float(cell) * 1e6)


IMPORTER = Importer("tum", (".tum", ".txt"), sniff, read, rank=5)
