"""ASAM OSI trace (``.osi``): a ground truth a moment, with every vehicle that has a row then.

Messages stand behind their lengths, 32 bits in little endian; positions are the site frame's metres, times
count from 1970, ids from 1 in the order of the vehicles.  Lost are load, battery and the log's own columns.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Selection
from fleetlog.registry import extra
from fleetlog.version import __version__

VERSION = (3, 7, 0)  # Of the interface: the fields that are written mean the same in all of version 3
COLUMNS = ("x", "y", "z", "heading", "speed")


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Moment by moment."""
    kind = extra("osi3.osi_groundtruth_pb2", "osi", "writing OSI needs osi-python").GroundTruth
    number = {vehicle: k for k, vehicle in enumerate(selection.vehicles, 1)}
    with path.open("wb") as out:
        for pieces in selection.windows(COLUMNS):
            moments: dict[int, Any] = {}
            for t in map(selection.placed, pieces):
                _add(moments, t, number[t.vehicle_id], kind)
            for time in sorted(moments):
                data = moments[time].SerializeToString()
                out.write(struct.pack("<I", len(data)) + data)
    return {"ids": {str(k): v for v, k in number.items()}}


def _add(moments: dict[int, Any], t: Trajectory, number: int, kind: Any) -> None:
    """The rows of a vehicle, each in the message of its moment."""
    columns = (t.time, *(t.floats(c) for c in COLUMNS))
    for time, x, y, z, heading, speed in zip(*(v.tolist() for v in columns), strict=True):
        if (said := moments.get(time)) is None:
            said = moments[time] = kind(model_reference=f"fleetlog {__version__}")
            v = said.version
            v.version_major, v.version_minor, v.version_patch = VERSION
            said.timestamp.seconds, said.timestamp.nanos = time // 1_000_000, time % 1_000_000 * 1000
        o = said.moving_object.add()
        o.id.value, o.type = number, o.TYPE_VEHICLE
        o.base.position.x, o.base.position.y = x, y
        if z == z:
            o.base.position.z = z
        if heading == heading:
            o.base.orientation.yaw = heading
        if heading == heading and speed == speed:
            o.base.velocity.x, o.base.velocity.y = speed * np.cos(heading), speed * np.sin(heading)
