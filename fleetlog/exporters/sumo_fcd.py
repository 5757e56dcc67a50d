"""SUMO's floating car data: every vehicle at every time step, in order of time.

``x, y`` are the site frame's metres, as in the network that ``sumo-net`` writes; ``angle`` is clockwise from
north; ``lane`` is lane 0 of the matched edge.  ``time`` counts from the dataset's start, which stands in a
comment so that an import gets the true times back."""

import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Selection, iso_times
from fleetlog.exporters.sumo_net import sumo_name

_COLUMNS = ("x", "y", "z", "heading", "speed", "edge_offset")


def write(selection: Selection, path: Path) -> None:
    """Times to the microsecond, positions to the millimetre."""
    origin: int | None = None
    with path.open("w", encoding="utf-8") as out:
        out.write('<?xml version="1.0" encoding="UTF-8"?>\n')
        for pieces in selection.windows((*_COLUMNS, "edge_id")):
            if origin is None:
                origin = min(int(p.time[0]) for p in pieces)
                out.write(f"<!-- fleetlog-epoch {iso_times(np.array([origin]))[0]} -->\n<fcd-export>\n")
            steps: dict[int, list[str]] = defaultdict(list)
            for time, line in chain.from_iterable(map(_lines, map(selection.placed, pieces))):
                steps[time].append(line)
            for time, lines in sorted(steps.items()):
                seconds, rest = divmod(time - origin, 1_000_000)
                stamp = f"{seconds}.{f'{rest:06d}'.rstrip('0') or '00'}"
                out.write(f'  <timestep time="{stamp}">\n{"".join(lines)}  </timestep>\n')
        out.write("<fcd-export>\n" if origin is None else "")
        out.write("</fcd-export>\n")


def _lines(t: Trajectory) -> Iterator[tuple[int, str]]:
    edges, who = t.labels("edge_id"), quoteattr(sumo_name(t.vehicle_id))
    names = [quoteattr(sumo_name(n) + "_0") for n in edges.names]
    columns = (t.floats(c).tolist() for c in _COLUMNS)
    rows = zip(t.time.tolist(), edges.codes.tolist(), *columns, strict=True)
    for time, edge, x, y, z, heading, speed, offset in rows:
        text = f'    <vehicle id={who} x="{x:.3f}" y="{y:.3f}"'
        text += f' z="{z:.3f}"' if z == z else ""
        text += f' angle="{math.degrees(math.pi / 2 - heading) % 360.0:.4f}"' if heading == heading else ""
        text += f' speed="{speed:.4f}"' if speed == speed else ""
        text += f" lane={names[edge]}" if edge >= 0 else ""
        text += f' pos="{offset:.3f}"' if edge >= 0 and offset == offset else ""
        yield time, text + "/>\n"
