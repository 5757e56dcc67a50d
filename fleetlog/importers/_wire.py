"""ROS, JSON and protobuf messages as objects of JSON; no schema and no code is taken from the file."""

import json
import struct
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

_STAMP: dict[int, Any] = {1: "sec", 2: "nsec"}
_POINT: dict[int, Any] = {1: "x", 2: "y", 3: "z"}
_POSE = {1: ("position", _POINT), 2: ("orientation", _POINT | {4: "w"})}
_LAYOUTS: dict[str, dict[int, Any]] = {
    "foxglove.LocationFix": {1: "latitude", 2: "longitude", 3: "altitude", 6: ("timestamp", _STAMP)},
    "foxglove.PoseInFrame": {1: ("timestamp", _STAMP), 3: ("pose", _POSE)},
}
"""Names of the fields of Foxglove's messages by number, with the layout of those that are messages."""


def _from_json(data: Any) -> dict[str, Any]:
    """The object that a message is."""
    message = json.loads(str(data, "utf-8"))
    if not isinstance(message, dict):
        raise ValueError("the message is no JSON object")
    return message


def readers(name: str) -> dict[str, Callable[[Any], dict[str, Any]]]:
    """What makes of the bytes of a ``name`` the object that it would be in JSON, by encoding.

    CDR is the plain one, in either order of bytes.  Broken bytes raise.
    """
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

    https://protobuf.dev/programming-guides/encoding/
    """
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
