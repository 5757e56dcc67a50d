"""Messages that carry a position or a battery's state, from bytes to values in SI units.

Known by schema name.  ROS: sensor_msgs/NavSatFix, nav_msgs/Odometry, geometry_msgs/PoseStamped and
PoseWithCovarianceStamped, sensor_msgs/BatteryState.  Foxglove: LocationFix and PoseInFrame, JSON, protobuf.
ASAM OSI: ground truths, sensor views and traffic updates.  No schema and no code is taken from the file."""

import json
import math
import struct
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, NamedTuple

import orjson

from fleetlog.importers._rows import TOPICS, Sample, finite, heading_of_quaternion
from fleetlog.importers._units import iso_time
from fleetlog.importers.osi import SCHEMAS, vehicles

_STAMP: dict[int, Any] = {1: "sec", 2: "nsec"}
_POINT: dict[int, Any] = {1: "x", 2: "y", 3: "z"}
_PLACE = {1: ("position", _POINT), 2: ("orientation", _POINT | {4: "w"})}
_LAYOUTS: dict[str, dict[int, Any]] = {
    "foxglove.LocationFix": {1: "latitude", 2: "longitude", 3: "altitude", 6: ("timestamp", _STAMP)},
    "foxglove.PoseInFrame": {1: ("timestamp", _STAMP), 3: ("pose", _PLACE)},
}
"""Names of the fields of Foxglove's messages by number, with the layout of those that are messages."""


def _from_json(data: Any) -> dict[str, Any]:
    """The object that a message is."""
    try:
        message = orjson.loads(data)
    except ValueError:  # orjson takes no NaN, which many write where there is no altitude
        message = json.loads(str(data, "utf-8"))
    if not isinstance(message, dict):
        raise ValueError("the message is no JSON object")
    return message


def readers(name: str) -> dict[str, Callable[[Any], dict[str, Any]]]:
    """What makes of the bytes of a ``name`` the object that it would be in JSON, by encoding. CDR is the
    plain one, in either order of bytes. Broken bytes raise."""
    found: dict[str, Callable[[Any], dict[str, Any]]] = {"json": _from_json}
    if name in _LAYOUTS:
        found["protobuf"] = lambda data: _named(_LAYOUTS[name], bytes(data))
    if "/" in name:
        found["cdr"] = partial(_from_ros, "ROS2_HUMBLE", name)
        found["ros1"] = partial(_from_ros, "ROS1_NOETIC", name)
    return found


@cache
def _types(version: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    types, kind = get_typestore(Stores[version]), "tf2_msgs/msg/TFMessage"
    if kind not in types.fielddefs:  # it is not among ROS 1's own
        types.register({kind: _types("ROS2_HUMBLE").fielddefs[kind]})
    return types


def _from_ros(version: str, name: str, data: Any) -> dict[str, Any]:
    types, kind = _types(version), name.replace("/", "/msg/")
    read = types.deserialize_cdr if version == "ROS2_HUMBLE" else types.deserialize_ros1
    return {k: _plain(v) for k, v in vars(read(data, kind)).items()}


def _plain(value: Any) -> Any:
    """What JSON would have of a message, but for its arrays."""
    if isinstance(value, list):
        return [_plain(part) for part in value]
    return {k: _plain(v) for k, v in vars(value).items()} if hasattr(value, "__msgtype__") else value


def _named(layout: dict[int, Any], data: bytes) -> dict[str, Any]:
    """A message by the names of its fields; a zero is not written."""
    given, out = dict(_fields(data)), {}
    for number, name in layout.items():
        if isinstance(name, str):
            out[name] = given.get(number, 0.0)
        else:
            out[name[0]] = _named(name[1], given.get(number, b""))
    return out


def _fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """(field number, value) of a message: varints as int, 64-bit as double, 32-bit as int, the rest as bytes.
    https://protobuf.dev/programming-guides/encoding/"""
    at, end = 0, len(data)
    while at < end:
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire in (1, 5):
            yield number, struct.unpack_from("<d" if wire == 1 else "<I", data, at)[0]
            at += 8 if wire == 1 else 4
        elif wire == 2:
            length, at = _varint(data, at)
            if length > end - at:
                raise ValueError("a field runs beyond the end of the message")
            yield number, data[at : at + length]
            at += length
        elif wire == 0:
            value, at = _varint(data, at)
            yield number, value
        else:
            raise ValueError("unknown wire type")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number is too long")


Decode = Callable[[Any], Sample | list[Sample]]


class Kind(NamedTuple):
    """A kind of message: ``rank`` orders sources of position (9: a battery), ``decode`` by encoding."""

    rank: int
    decode: dict[str, Decode]
    meaning: str

    @property
    def is_position(self) -> bool:
        """Whether it can tell where the vehicle is."""
        return self.rank < 9


def normal_name(schema: str) -> str:
    """``sensor_msgs/msg/NavSatFix`` and ``sensor_msgs/NavSatFix`` are one."""
    return schema.replace("/msg/", "/")


def numbers(part: dict[str, Any], *names: str) -> list[float]:
    """The fields of a message called ``names``; NaN for those that it has not."""
    return [finite(part.get(name)) for name in names]


def stamp_of(message: dict[str, Any]) -> int:
    """The stamp [us] of a message or of its header; 0 where it has none."""
    stamp = message.get("timestamp")
    if stamp is None and isinstance(header := message.get("header"), dict):
        stamp = header.get("stamp")
    if isinstance(stamp, str):
        return iso_time(stamp)
    if not isinstance(stamp, dict):
        return 0
    seconds, fine = stamp.get("sec"), stamp.get("nsec")
    if type(seconds) is int and type(fine) is int:
        return seconds * 1_000_000 + (fine + 500) // 1000
    seconds = stamp["sec"] if "sec" in stamp else stamp.get("secs", 0)
    fine = next((stamp[name] for name in ("nsec", "nanosec", "nsecs") if name in stamp), 0)
    return int(finite(seconds)) * 1_000_000 + (int(finite(fine)) + 500) // 1000


def _said_fix(m: dict[str, Any]) -> Sample:
    status = m.get("status")
    blind = isinstance(status, dict) and finite(status.get("status")) < 0
    latitude, longitude, z = numbers(m, "latitude", "longitude", "altitude")
    return Sample(stamp_of(m), {"latitude": latitude, "longitude": longitude, "z": z}, not blind)


def _said_pose(m: dict[str, Any]) -> Sample:
    """With covariance, pose and twist lie one level deeper."""
    pose = m["pose"].get("pose", m["pose"])
    values = dict(zip("xyz", numbers(pose["position"], *"xyz"), strict=True))
    values["heading"] = heading_of_quaternion(*numbers(pose["orientation"], *"xyzw"))
    if isinstance(m.get("twist"), dict):
        values["speed"] = math.hypot(*numbers(m["twist"]["twist"]["linear"], "x", "y"))
    return Sample(stamp_of(m), values)


def _said_battery(m: dict[str, Any], unit: float = 1.0) -> Sample:
    """ROS counts the current negative while discharging, the contract positive; ``unit`` is of the charge."""
    voltage, current, warmth, soc = numbers(m, "voltage", "current", "temperature", "percentage")
    values = {"battery_voltage": voltage, "battery_current": -current, "soc": soc * unit}
    values["battery_temperature"] = warmth
    return Sample(stamp_of(m), {name: value for name, value in values.items() if value == value})


def _osi(schema: str) -> dict[str, Decode]:
    """A trace may count from zero, which as a stamp is none: then a microsecond later."""
    return {"protobuf": lambda d: [s._replace(stamp=max(s.stamp, 1)) for s in vehicles(schema, d)]}


def _decoders(name: str, said: Callable[[dict[str, Any]], Sample]) -> dict[str, Decode]:
    def after(read: Callable[[Any], dict[str, Any]]) -> Decode:
        return lambda data: said(read(data))

    return {encoding: after(read) for encoding, read in readers(name).items()}


_SAID: dict[str, Callable[[dict[str, Any]], Sample]] = {
    "fix": _said_fix, "pose": _said_pose, "battery": _said_battery,
    "percent": partial(_said_battery, unit=0.01),
}  # fmt: skip
KINDS = {name: Kind(rank, _decoders(name, _SAID[how]), told) for name, (rank, how, told) in TOPICS.items()}
KINDS |= {name: Kind(5, _osi(name), "position, heading and speed of every vehicle") for name in SCHEMAS}
POSITIONS = ("latitude", "longitude", "x", "y", "z")


class Topic(NamedTuple):
    """A topic of a recording: its name, the name of its schema and the encoding of its messages."""

    name: str
    schema: str
    encoding: str

    @property
    def kind(self) -> Kind | None:
        """How it is read, or None."""
        kind = KINDS.get(normal_name(self.schema))
        return kind if kind and self.encoding in kind.decode else None
