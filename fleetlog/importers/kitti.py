"""KITTI poses: twelve numbers a line, the first three rows of a pose; seconds in ``times.txt`` beside it.

Axes are those of the export: x, y on the floor and z up."""

import math
from collections.abc import Iterator
from functools import partial

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes
from fleetlog.importers._rows import Records, figures, mostly
from fleetlog.importers.base import LOCAL, Importer

TIMES = "times.txt"


def _pose(line: bytes) -> list[float] | None:
    """The numbers of a line whose first column of the rotation has length one."""
    n = figures(line, 12)
    return n if n and abs(math.hypot(n[0], n[4], n[8]) - 1.0) < 0.05 else None


class _Kitti(Records):
    """One row a line; the heading is the yaw of the rotation."""

    places = (LOCAL,)

    def records(self) -> Iterator[tuple[bytes, bytes]]:
        beside = self.path.parent / TIMES
        if not beside.is_file():
            do = f"put the seconds beside it, one a line, as {TIMES}"
            raise FormatError("KITTI poses have no times of their own", where=self.path, do=do)
        clock, _ = open_bytes(beside, self.report)
        with clock:
            yield from ((line, clock.readline(self.longest)) for line in super().records())

    def take(self, record: tuple[bytes, bytes], number: int) -> None:
        line, stamp = record
        if (pose := _pose(line)) is None:
            self.rows.reject(number, "not twelve numbers with a rotation", line.decode("latin-1").strip())
            return
        try:
            time = self.origin + round(float(stamp) * 1e6)
        except (ValueError, OverflowError):
            self.rows.reject(number, f"no time in {TIMES}", stamp.decode("latin-1").strip())
            return
        values = {"x": pose[3], "y": pose[7], "z": pose[11], "heading": math.atan2(pose[4], pose[0])}
        self.rows.add(self.vehicle, time, number, values)


IMPORTER = Importer("kitti", (".txt", ".kitti"), partial(mostly, _pose), _Kitti.batches, rank=5)
