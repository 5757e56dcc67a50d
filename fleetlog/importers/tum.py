"""TUM trajectories: ``timestamp x y z qx qy qz qw`` a line, seconds and metres, as evo writes them."""

import math
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path

from fleetlog.importers._open import open_bytes
from fleetlog.importers._rows import Rows, figures, gather, heading_of_quaternion, mostly
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

LINE_LIMIT = 4096


def _pose(line: bytes) -> list[float] | None:
    numbers = figures(line.replace(b",", b" "), 8)
    return numbers if numbers and abs(math.hypot(*numbers[4:]) - 1.0) <= 0.05 else None


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """One row a line; the heading is the yaw of the quaternion."""
    stream, raw = open_bytes(path, options.report)
    rows = Rows("x", "y", share=lambda: raw.share)

    def take(line: bytes, number: int) -> None:
        if line.strip() and not line.lstrip().startswith(b"#"):
            _add(rows, options, _pose(line), line, number)

    with stream:
        yield from gather(iter(lambda: stream.readline(LINE_LIMIT), b""), take, rows)
    if not rows.total:
        raise options.report.nothing("no line reads 'timestamp x y z qx qy qz qw'")
    since = " since the profile's origin" if options.origin else ""
    options.report.recognised |= {
        "timestamp": f"timestamp, from s{since}", "x y z": "position in the site frame, from m",
        "qx qy qz qw": "heading, the yaw of the quaternion",
    }  # fmt: skip
    yield from rows.drain()


def _add(rows: Rows, options: ReadOptions, pose: list[float] | None, line: bytes, number: int) -> None:
    if pose is None or not -(1 << 62) < pose[0] * 1e6 < 1 << 62:
        rows.reject(number, "not eight numbers ending in a unit quaternion", line.decode("latin-1").strip())
        return
    values = {"x": pose[1], "y": pose[2], "z": pose[3], "heading": heading_of_quaternion(*pose[4:])}
    # Exact: a double holds only a quarter of a microsecond.
    seconds = Decimal(line.replace(b",", b" ").split()[0].decode())
    rows.add(options.name, options.origin + int(seconds * 1_000_000), number, values)


IMPORTER = Importer("tum", (".tum", ".txt"), mostly(_pose), read, rank=5)
