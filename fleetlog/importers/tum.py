"""TUM trajectories: ``timestamp x y z qx qy qz qw`` a line, seconds and metres, as evo writes them."""

import math
from decimal import Decimal
from functools import partial

from fleetlog.importers._rows import Records, figures, heading_of_quaternion, mostly
from fleetlog.importers.base import LOCAL, Importer


def _pose(line: bytes) -> list[float] | None:
    numbers = figures(line.replace(b",", b" "), 8)
    return numbers if numbers and abs(math.hypot(*numbers[4:]) - 1.0) <= 0.05 else None


class _Tum(Records):
    """One row a line; the heading is the yaw of the quaternion."""

    places = (LOCAL,)

    def take(self, line: bytes, number: int) -> None:
        if not line.strip() or line.lstrip().startswith(b"#"):
            return
        pose = _pose(line)
        if pose is None or not -(1 << 62) < pose[0] * 1e6 < 1 << 62:
            self.rows.reject(number, "not eight numbers with a unit quaternion", str(line, "latin-1").strip())
            return
        values = {"x": pose[1], "y": pose[2], "z": pose[3], "heading": heading_of_quaternion(*pose[4:])}
        # Exact: a double holds only a quarter of a microsecond.
        seconds = Decimal(line.replace(b",", b" ").split()[0].decode())
        self.rows.add(self.vehicle, self.origin + int(seconds * 1_000_000), number, values)


IMPORTER = Importer("tum", (".tum", ".txt"), partial(mostly, _pose), _Tum.batches, rank=5)
