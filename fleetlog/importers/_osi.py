"""ASAM OSI messages: the vehicles of a ground truth, a sensor view or a traffic update.

The classes of the messages come with osi-python (the extra ``osi``).
https://opensimulationinterface.github.io/osi-antora-generator
"""

import math
from importlib import import_module
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._rows import Sample

SCHEMAS = ("osi3.SensorView", "osi3.GroundTruth", "osi3.TrafficUpdate")
PEDESTRIAN, ANIMAL = 3, 4
"""Types of moving objects that are no vehicles."""


def message(schema: str) -> Any:
    """The class of a message; an error that names the extra where it is missing."""
    name = schema.removeprefix("osi3.")
    try:
        return getattr(import_module(f"osi3.osi_{name.lower()}_pb2"), name)
    except ImportError:
        what, do = "reading OSI needs osi-python", 'install it with: pip install "fleetlog[osi]"'
        raise FormatError(what, do=do) from None


def vehicles(schema: str, data: Any) -> list[Sample]:
    """One sample a vehicle, at the time of the message; :class:`ValueError` for bytes that are none."""
    from google.protobuf.message import DecodeError

    try:
        said = message(schema).FromString(bytes(data))
    except DecodeError as error:
        raise ValueError(str(error)) from None
    truth = said.global_ground_truth if schema == "osi3.SensorView" else said
    objects = truth.update if schema == "osi3.TrafficUpdate" else truth.moving_object
    stamp = said.timestamp.seconds * 1_000_000 + (said.timestamp.nanos + 500) // 1000
    return [_sample(o, stamp) for o in objects if o.HasField("id") and o.type not in (PEDESTRIAN, ANIMAL)]


def _sample(o: Any, stamp: int) -> Sample:
    """``base.position`` is the middle of the bounding box; the speed is the length of the velocity."""
    place, yaw = o.base.position, o.base.orientation.yaw
    values = {"x": place.x, "y": place.y, "z": place.z, "heading": math.remainder(yaw, math.tau)}
    if o.base.HasField("velocity"):
        values["speed"] = math.hypot(o.base.velocity.x, o.base.velocity.y)
    return Sample(stamp, values, vehicle=str(o.id.value))
