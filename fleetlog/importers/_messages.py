"""Messages that carry a position or a battery's state, from bytes to values in SI units.

Known by schema name.  ROS: sensor_msgs/NavSatFix, nav_msgs/Odometry, geometry_msgs/PoseStamped and
PoseWithCovarianceStamped, sensor_msgs/BatteryState.  Foxglove: LocationFix and PoseInFrame, as JSON and
protobuf.  ASAM OSI: ground truths, sensor views and traffic updates, each with many vehicles.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from fleetlog.importers._rows import Sample, finite, heading_of_quaternion
from fleetlog.importers._times import iso_time
from fleetlog.importers._wire import readers
from fleetlog.importers.osi import SCHEMAS, vehicles

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


def _fix_values(latitude: float, longitude: float, altitude: float) -> dict[str, float]:
    return {"latitude": latitude, "longitude": longitude, "z": altitude}


def _pose_values(x: float, y: float, z: float, *quaternion: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z, "heading": heading_of_quaternion(*quaternion)}


def _battery_values(voltage: float, current: float, temperature: float, soc: float) -> dict[str, float]:
    """ROS counts the current negative while discharging; the contract the other way round."""
    values = {"battery_voltage": voltage, "battery_current": -current, "soc": soc}
    values["battery_temperature"] = temperature
    return {name: value for name, value in values.items() if value == value}


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
    seconds = stamp["sec"] if "sec" in stamp else stamp.get("secs", 0)
    fine = next((stamp[name] for name in ("nsec", "nanosec", "nsecs") if name in stamp), 0)
    return int(finite(seconds)) * 1_000_000 + (int(finite(fine)) + 500) // 1000


def _said_fix(m: dict[str, Any]) -> Sample:
    status = m.get("status")
    blind = isinstance(status, dict) and finite(status.get("status")) < 0
    place = (finite(m.get(name)) for name in ("latitude", "longitude", "altitude"))
    return Sample(stamp_of(m), _fix_values(*place), not blind)


def _said_pose(m: dict[str, Any]) -> Sample:
    """With covariance, pose and twist lie one level deeper."""
    pose = m["pose"].get("pose", m["pose"])
    values = _pose_values(*numbers(pose["position"], *"xyz"), *numbers(pose["orientation"], *"xyzw"))
    if isinstance(m.get("twist"), dict):
        values["speed"] = math.hypot(*numbers(m["twist"]["twist"]["linear"], "x", "y"))
    return Sample(stamp_of(m), values)


def _said_battery(m: dict[str, Any]) -> Sample:
    figures = numbers(m, "voltage", "current", "temperature", "percentage")
    return Sample(stamp_of(m), _battery_values(*figures))


def _in_percent(m: dict[str, Any]) -> Sample:
    sample = _said_battery(m)
    sample.values["soc"] = sample.values.get("soc", math.nan) * 0.01
    return sample


def _osi(schema: str) -> dict[str, Decode]:
    """A trace may count from zero, which as a stamp is none: then a microsecond later."""
    return {"protobuf": lambda d: [s._replace(stamp=max(s.stamp, 1)) for s in vehicles(schema, d)]}


def _decoders(name: str, said: Callable[[dict[str, Any]], Sample]) -> dict[str, Decode]:
    def after(read: Callable[[Any], dict[str, Any]]) -> Decode:
        return lambda data: said(read(data))

    return {encoding: after(read) for encoding, read in readers(name).items()}


_FIX = "position, WGS 84"
_POSE = "position and heading in the site frame, from m and quaternion"
_BATTERY = "soc, voltage and current of the battery (current > 0 when discharging)"
_READ: tuple[tuple[str, int, Callable[[dict[str, Any]], Sample], str], ...] = (
    ("foxglove.LocationFix", 0, _said_fix, _FIX),
    ("sensor_msgs/NavSatFix", 1, _said_fix, _FIX),
    ("geometry_msgs/PoseWithCovarianceStamped", 2, _said_pose, _POSE),
    ("geometry_msgs/PoseStamped", 3, _said_pose, _POSE),
    ("foxglove.PoseInFrame", 4, _said_pose, _POSE),
    ("nav_msgs/Odometry", 6, _said_pose, _POSE + ", speed"),
    ("sensor_msgs/BatteryState", 9, _said_battery, _BATTERY),
    ("foxglove.Battery", 9, _in_percent, _BATTERY + ", percentage from %"),
)
KINDS: dict[str, Kind] = {
    **{name: Kind(rank, _decoders(name, said), meaning) for name, rank, said, meaning in _READ},
    **{name: Kind(5, _osi(name), "position, heading and speed of every vehicle") for name in SCHEMAS},
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
