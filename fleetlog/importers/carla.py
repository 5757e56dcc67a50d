"""CARLA recorder logs (version 1): where every vehicle was in every frame, read without a server.

An information header, then packets of a kind, a length and data, little endian.  Positions are centimetres
of the Unreal engine, whose y points right and whose angles turn clockwise; here y points left, as in the
OpenDRIVE map that CARLA drives on.  Times are the recording's date and the seconds of simulation since.
https://carla.readthedocs.io/en/latest/ref_recorder_binary_file_format/"""

import math
import struct
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from fleetlog.errors import FormatError
from fleetlog.importers._open import Damaged, cut, packets
from fleetlog.importers._rows import Records, finite
from fleetlog.importers.base import LOCAL, Importer

MAGIC = b"CARLA_RECORDER"
FRAME_START, EVENT_ADD, POSITION = 0, 2, 6
VEHICLE, CENTIMETRE = 1, 0.01
_PACKET, _FRAME, _PLACE = struct.Struct("<BI"), struct.Struct("<Qdd"), struct.Struct("<I6f")
_ADDED, _SHORT = struct.Struct("<IB6fI"), struct.Struct("<H")


def sniff(path: Path, head: bytes) -> bool:
    """The version, and the magic text behind its length."""
    return head[2:4] == struct.pack("<H", len(MAGIC)) and head[4:].startswith(MAGIC)


class _Carla(Records):
    """One row a vehicle and frame; walkers and other actors are left out."""

    places = (LOCAL,)

    def records(self) -> Iterator[tuple[int, bytes]]:
        """Packets behind the header, which says the recording's date and map."""
        try:
            version, _ = struct.unpack("<H", self.stream.read(2))[0], _text(self.stream)
            date, town = struct.unpack("<q", self.stream.read(8))[0], _text(self.stream)
        except struct.error:
            raise FormatError("breaks off in its header", where=self.path, do="record it again") from None
        if version != 1:
            raise FormatError(f"is version {version} of the format", where=self.path, do="give version 1")
        self.report.note(f"recorded by CARLA on the map {town}")
        self._names: dict[int, str] = {}  # Of the vehicles
        self._start = self._time = self.origin or date * 1_000_000
        yield from packets(self.stream, _PACKET, self.report)

    def take(self, packet: tuple[int, bytes], number: int) -> None:
        kind, data = packet
        try:
            if kind == FRAME_START:
                self._time = self._start + round(_FRAME.unpack(data)[2] * 1e6)
            elif kind == EVENT_ADD:
                self._names |= dict(_added(data))
            elif kind == POSITION:
                self._places(data, number)
        except (Damaged, struct.error, ValueError, OverflowError) as error:
            self.rows.reject(number, f"the packet of kind {kind} is damaged", error)

    def _places(self, data: bytes, number: int) -> None:
        for actor, x, y, z, _, _, yaw in _PLACE.iter_unpack(data[2:]):
            if (name := self._names.get(actor)) is None:
                continue
            values = {"x": x * CENTIMETRE, "y": -y * CENTIMETRE, "z": z * CENTIMETRE}
            values["heading"] = math.remainder(-math.radians(finite(yaw)), math.tau)
            self.rows.add(name, self._time, number, values)


def _text(stream: BufferedReader) -> str:
    return stream.read(struct.unpack("<H", stream.read(2))[0]).decode("utf-8", "replace")


def _added(data: bytes) -> Iterator[tuple[int, str]]:
    """(actor, name) of the vehicles that a packet adds: ``tesla.model3-27`` of ``vehicle.tesla.model3``."""
    (count,), at = struct.unpack_from("<H", data), 2
    for _ in range(count):
        actor, kind = _ADDED.unpack_from(data, at)[:2]
        name, at = cut(data, at + _ADDED.size, _SHORT)
        (attributes,), at = struct.unpack_from("<H", data, at), at + 2
        for _ in range(attributes):
            _, at = cut(data, at + 1, _SHORT)
            _, at = cut(data, at, _SHORT)
        if kind == VEHICLE:
            yield actor, f"{name.decode('utf-8', 'replace').removeprefix('vehicle.')}-{actor}"


IMPORTER = Importer("carla", (".log", ".rec"), sniff, _Carla.batches)
