"""Messages that carry a position or a battery's state, from bytes to values in SI units.

Known by schema name.  ROS: sensor_msgs/NavSatFix, nav_msgs/Odometry, geometry_msgs/PoseStamped and
PoseWithCovarianceStamped, sensor_msgs/BatteryState.  Foxglove: LocationFix and PoseInFrame, as JSON and
protobuf.  ASAM OSI: ground truths, sensor views and traffic updates, each with many vehicles.
"""

import json
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from fleetlog.importers._osi import SCHEMAS, vehicles
from fleetlog.importers._rows import Sample, finite, heading_of_quaternion
from fleetlog.importers._times import iso_time
from fleetlog.importers._wire import Wire, fields

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


def _navsat(w: Wire) -> Sample:
    stamp, _ = w.header()
    (status,), _ = w.take("b"), w.take("H")
    latitude, longitude, altitude = w.take("d", 3)
    return Sample(stamp, {"latitude": latitude, "longitude": longitude, "z": altitude}, status >= 0)


def _pose_values(w: Wire) -> dict[str, float]:
    x, y, z, *quaternion = w.take("d", 7)
    return {"x": x, "y": y, "z": z, "heading": heading_of_quaternion(*quaternion)}


def _pose(w: Wire) -> Sample:
    return Sample(w.header()[0], _pose_values(w))


def _odometry(w: Wire) -> Sample:
    stamp, _ = w.header()
    w.text()
    values = _pose_values(w)
    w.take("d", 36)
    forward, sideways = w.take("d", 2)
    values["speed"] = math.hypot(forward, sideways)
    return Sample(stamp, values)


def _battery(w: Wire) -> Sample:
    """ROS counts the current negative while discharging; the contract the other way round."""
    stamp, _ = w.header()
    voltage, temperature, current, _, _, _, share = w.take("f", 7)
    return Sample(stamp, _battery_values(voltage, current, temperature, share))


def _battery_values(voltage: float, current: float, temperature: float, soc: float) -> dict[str, float]:
    values = {"battery_voltage": voltage, "battery_current": -current, "soc": soc}
    values["battery_temperature"] = temperature
    return {name: value for name, value in values.items() if value == value}


def json_stamp(message: dict[str, Any]) -> int:
    """The stamp [us] of a message or of its header; 0 where it has none."""
    header = message.get("header")
    stamp = message.get("timestamp", header.get("stamp") if isinstance(header, dict) else None)
    if isinstance(stamp, str):
        return iso_time(stamp)
    if not isinstance(stamp, dict):
        return 0
    seconds = finite(stamp.get("sec", stamp.get("secs", 0)))
    nanoseconds = finite(stamp.get("nsec", stamp.get("nanosec", stamp.get("nsecs", 0))))
    return int(seconds) * 1_000_000 + (int(nanoseconds) + 500) // 1000


def json_object(data: Any) -> dict[str, Any]:
    """The object that a message is."""
    message = json.loads(bytes(data))
    if not isinstance(message, dict):
        raise ValueError("the message is no JSON object")
    return message


def json_part(message: dict[str, Any], *path: str) -> dict[str, Any]:
    """The object below some keys."""
    for key in path:
        below = message.get(key)
        if not isinstance(below, dict):
            raise ValueError(f"the message has no {key}")
        message = below
    return message


def _json_fix(data: Any) -> Sample:
    m = json_object(data)
    status = m.get("status")
    fix = not (isinstance(status, dict) and finite(status.get("status")) < 0)
    where = {"latitude": finite(m.get("latitude")), "longitude": finite(m.get("longitude"))}
    return Sample(json_stamp(m), {**where, "z": finite(m.get("altitude"))}, fix)


def _json_pose(*path: str) -> Decode:
    def decode(data: Any) -> Sample:
        m = json_object(data)
        pose = json_part(m, *path)
        p, q = json_part(pose, "position"), json_part(pose, "orientation")
        values = {k: finite(p.get(k)) for k in ("x", "y", "z")}
        values["heading"] = heading_of_quaternion(*(finite(q.get(k)) for k in ("x", "y", "z", "w")))
        twist = m.get("twist")
        if isinstance(twist, dict):
            linear = json_part(twist, "twist", "linear")
            values["speed"] = math.hypot(finite(linear.get("x")), finite(linear.get("y")))
        return Sample(json_stamp(m), values)

    return decode


def _json_battery(percent: float) -> Decode:
    def decode(data: Any) -> Sample:
        m = json_object(data)
        names = ("voltage", "current", "temperature", "percentage")
        volts, amperes, degrees, share = (finite(m.get(name)) for name in names)
        return Sample(json_stamp(m), _battery_values(volts, amperes, degrees, share * percent))

    return decode


def _proto_stamp(data: bytes) -> int:
    parts = dict(fields(data))
    return int(parts.get(1, 0)) * 1_000_000 + (int(parts.get(2, 0)) + 500) // 1000


def _proto_fix(data: Any) -> Sample:
    """foxglove.LocationFix: latitude 1, longitude 2, altitude 3, timestamp 6."""
    stamp, numbers = 0, {1: 0.0, 2: 0.0, 3: 0.0}
    for number, value in fields(data):
        if number == 6:
            stamp = _proto_stamp(value)
        elif number in numbers:
            numbers[number] = value
    return Sample(stamp, {"latitude": numbers[1], "longitude": numbers[2], "z": numbers[3]})


def _proto_pose(data: Any) -> Sample:
    """foxglove.PoseInFrame: timestamp 1, pose 3 (position 1, orientation 2); a zero is not written."""
    message = dict(fields(data))
    pose = dict(fields(message[3])) if 3 in message else {}
    p, q = (dict(fields(pose[k])) if k in pose else {} for k in (1, 2))
    values = {name: p.get(i, 0.0) for i, name in ((1, "x"), (2, "y"), (3, "z"))}
    values["heading"] = heading_of_quaternion(*(q.get(i, 0.0) for i in (1, 2, 3, 4)))
    return Sample(_proto_stamp(message[1]) if 1 in message else 0, values)


def _osi(schema: str) -> dict[str, Decode]:
    """A trace may count from zero, which as a stamp is none: then a microsecond later."""
    return {"protobuf": lambda d: [s._replace(stamp=max(s.stamp, 1)) for s in vehicles(schema, d)]}


def _ros(decode: Callable[[Wire], Sample], in_json: Decode) -> dict[str, Decode]:
    return {"cdr": lambda d: decode(Wire(d)), "ros1": lambda d: decode(Wire(d, ros1=True)), "json": in_json}


_FIX = "position, WGS 84"
_POSE = "position and heading in the site frame, from m and quaternion"
_BATTERY = "soc, voltage and current of the battery (current > 0 when discharging)"
KINDS: dict[str, Kind] = {
    "foxglove.LocationFix": Kind(0, {"json": _json_fix, "protobuf": _proto_fix}, _FIX),
    "sensor_msgs/NavSatFix": Kind(1, _ros(_navsat, _json_fix), _FIX),
    "geometry_msgs/PoseWithCovarianceStamped": Kind(2, _ros(_pose, _json_pose("pose", "pose")), _POSE),
    "geometry_msgs/PoseStamped": Kind(3, _ros(_pose, _json_pose("pose")), _POSE),
    "foxglove.PoseInFrame": Kind(4, {"json": _json_pose("pose"), "protobuf": _proto_pose}, _POSE),
    **{name: Kind(5, _osi(name), "position, heading and speed of every vehicle") for name in SCHEMAS},
    "nav_msgs/Odometry": Kind(6, _ros(_odometry, _json_pose("pose", "pose")), _POSE + ", speed"),
    "sensor_msgs/BatteryState": Kind(9, _ros(_battery, _json_battery(1.0)), _BATTERY),
    "foxglove.Battery": Kind(9, {"json": _json_battery(0.01)}, _BATTERY + ", percentage from %"),
}
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
