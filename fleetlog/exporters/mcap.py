"""MCAP with JSON channels that Foxglove draws: ``/ID/fix`` (foxglove.LocationFix) or, without a place on
earth, ``/ID/pose`` (foxglove.PoseInFrame), and ``/ID/battery`` where the dataset knows it.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Exporter, Selection
from fleetlog.version import __version__

_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_NUMBER = {"type": "number"}
_XYZ = {"type": "object", "properties": dict.fromkeys("xyz", _NUMBER)}
_XYZW = {"type": "object", "properties": dict.fromkeys("xyzw", _NUMBER)}
_POSE = {"type": "object", "properties": {"position": _XYZ, "orientation": _XYZW}}
SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.LocationFix": {"timestamp": _TIME, "frame_id": {"type": "string"}, "latitude": _NUMBER,
                             "longitude": _NUMBER, "altitude": _NUMBER},
    "foxglove.PoseInFrame": {"timestamp": _TIME, "frame_id": {"type": "string"}, "pose": _POSE},
    "foxglove.Battery": {"timestamp": _TIME, "percentage": _NUMBER, "voltage": _NUMBER, "current": _NUMBER},
}  # fmt: skip

_BATTERY = (
    ("percentage", "soc", 100.0), ("voltage", "battery_voltage", 1.0), ("current", "battery_current", -1.0),
)  # fmt: skip


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Vehicle by vehicle; readers sort by time through the index."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library=f"fleetlog {__version__}")
        channels = _Channels(writer)
        for t in selection.days():
            placed = selection.placed(t)
            if selection.frame is not None:
                _fixes(channels, placed, selection.frame)
            else:
                _poses(channels, placed)
            _batteries(channels, t)
        writer.finish()
    return selection.counts


class _Channels:
    """Channels made when first written to."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def send(self, topic: str, schema: str, time: int, message: dict[str, Any]) -> None:
        if schema not in self._schemas:
            text = json.dumps({"title": schema, "type": "object", "properties": SCHEMAS[schema]})
            self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text.encode())
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        stamp = {"sec": time // 1_000_000, "nsec": time % 1_000_000 * 1000}
        data = json.dumps({"timestamp": stamp, **message}, allow_nan=False).encode()
        self._writer.add_message(self._channels[topic], time * 1000, data, time * 1000)


def _topic(vehicle: str, what: str) -> str:
    return f"/{vehicle.strip('/').replace('/', '_')}/{what}"


def _fixes(channels: _Channels, t: Trajectory, frame: Frame) -> None:
    topic, z = _topic(t.vehicle_id, "fix"), t.floats("z")
    columns = (t.time, *frame.to_geographic(t.floats("x"), t.floats("y")), z)
    for time, latitude, longitude, up in zip(*(v.tolist() for v in columns), strict=True):
        place = {"frame_id": "site", "latitude": latitude, "longitude": longitude}
        height = {"altitude": up} if up == up else {}
        channels.send(topic, "foxglove.LocationFix", time, {**place, **height})


def _poses(channels: _Channels, t: Trajectory) -> None:
    topic, z, half = _topic(t.vehicle_id, "pose"), t.floats("z"), np.nan_to_num(t.floats("heading")) / 2
    columns = (t.time, t.floats("x"), t.floats("y"), np.nan_to_num(z), np.sin(half), np.cos(half))
    for time, x, y, up, s, c in zip(*(v.tolist() for v in columns), strict=True):
        turn = {"x": 0.0, "y": 0.0, "z": s, "w": c}
        pose = {"position": {"x": x, "y": y, "z": up}, "orientation": turn}
        channels.send(topic, "foxglove.PoseInFrame", time, {"frame_id": "site", "pose": pose})


def _batteries(channels: _Channels, t: Trajectory) -> None:
    """Current by the convention of ROS: negative while discharging."""
    columns = {n: (t.floats(c) * factor).tolist() for n, c, factor in _BATTERY if t.has(c)}
    for i, time in enumerate(t.time.tolist() if columns else []):
        message = {name: values[i] for name, values in columns.items() if values[i] == values[i]}
        if message:
            channels.send(_topic(t.vehicle_id, "battery"), "foxglove.Battery", time, message)


EXPORTER = Exporter("mcap", ".mcap", "MCAP for Foxglove: LocationFix (or poses) and battery as JSON", write)
