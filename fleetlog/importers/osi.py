"""ASAM OSI traces (``.osi``): messages behind their lengths, 32 bits in little endian.

What kind of message a trace holds stands in its name (``..._gt_...``, as the standard names files); where it
does not, the first message tells.  In MCAP files, messages of the same kinds are read as topics.
The classes of the messages come with osi-python (the extra ``osi``).
https://opensimulationinterface.github.io/osi-antora-generator"""

import math
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._open import PACKET_LIMIT, head_of, packets, plain_suffix
from fleetlog.importers._rows import Records, Sample
from fleetlog.importers.base import LOCAL, Importer
from fleetlog.registry import extra

_LENGTH = struct.Struct("<I")
_VERSION = 0x0A  # Every message begins with its version: field 1, a message
SCHEMAS = ("osi3.SensorView", "osi3.GroundTruth", "osi3.TrafficUpdate")
PEDESTRIAN, ANIMAL = 3, 4  # Types of moving objects that are no vehicles
_KINDS = {"sv": "osi3.SensorView", "gt": "osi3.GroundTruth", "tu": "osi3.TrafficUpdate"}


def sniff(path: Path, head: bytes) -> bool:
    """A length and the version of a message, in a file with the right suffix."""
    first = _LENGTH.unpack_from(head)[0] if len(head) > 4 else 0
    return plain_suffix(path) == ".osi" and 0 < first <= PACKET_LIMIT and head[4] == _VERSION


class _Osi(Records):
    """One row a vehicle and message, in the metres of the trace."""

    places = (LOCAL,)

    def records(self) -> Iterator[tuple[bytes]]:
        self._schema = _schema(self.path)
        return packets(self.stream, _LENGTH, self.report)

    def take(self, packet: tuple[bytes], number: int) -> None:
        try:
            found = vehicles(self._schema, packet[0])
        except ValueError as error:
            self.rows.reject(number, f"no {self._schema} message", error)
            return
        for sample in found:
            self.rows.add(sample.vehicle, self.origin + sample.stamp, number, sample.values)

    def describe(self) -> None:
        meaning = "position, heading and speed of every vehicle, from m, rad and m/s"
        self.report.recognised[self._schema] = meaning


def vehicles(schema: str, data: Any) -> list[Sample]:
    """One sample a vehicle, at the time of the message; :class:`ValueError` for bytes that are none."""
    name = schema.removeprefix("osi3.")
    module = f"osi3.osi_{name.lower()}_pb2"
    kind = getattr(extra(module, "osi", "reading OSI needs osi-python", error=FormatError), name)
    from google.protobuf.message import DecodeError

    try:
        said = kind.FromString(bytes(data))
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


def _schema(path: Path) -> str:
    """The kind of messages: as the name says, else the first one that finds vehicles."""
    if words := [word for word in re.split(r"[_.]", path.name.lower()) if word in _KINDS]:
        return _KINDS[words[0]]
    head = head_of(path, PACKET_LIMIT)
    first = head[4 : 4 + _LENGTH.unpack_from(head)[0]]
    for schema in SCHEMAS:
        with suppress(ValueError):
            if vehicles(schema, first):
                return schema
    return "osi3.GroundTruth"


IMPORTER = Importer("osi", (".osi",), sniff, _Osi.batches)
