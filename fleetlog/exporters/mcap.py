"""MCAP with JSON channels that Foxglove draws: ``/ID/fix`` (foxglove.LocationFix) or, without a place on
earth, ``/ID/pose`` (foxglove.PoseInFrame), and ``/ID/battery`` where the dataset knows it.
"""

from __future__ import annotations

import json
import math
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


def write(selection: Selection, path: Path) -> dict[str, Any]:
    """Vehicle by vehicle; readers sort by time through the index."""
    from mcap.writer import CompressionType, Writer

    rows = left_out = 0
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library=f"fleetlog {__version__}")
        channels = _Channels(writer)
        for trajectory in selection.days():
            written = _positions(channels, trajectory, selection.frame)
            _batteries(channels, trajectory)
            rows += written
            left_out += len(trajectory) - written
        writer.finish()
    return {"rows": rows, "rows_without_position": left_out}


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


def _positions(channels: _Channels, t: Trajectory, frame: Frame | None) -> int:
    x, y, z = t.floats("x"), t.floats("y"), t.floats("z")
    written = 0
    if frame is not None:
        latitude, longitude = frame.to_geographic(x, y)
        for time, lat, lon, up in zip(
            t.time.tolist(), latitude.tolist(), longitude.tolist(), z.tolist(), strict=True
        ):
            if math.isfinite(lat) and math.isfinite(lon):
                height = {"altitude": up} if up == up else {}
                message = {"frame_id": "site", "latitude": lat, "longitude": lon, **height}
                channels.send(_topic(t.vehicle_id, "fix"), "foxglove.LocationFix", time, message)
                written += 1
        return written
    headings = np.nan_to_num(t.floats("heading")).tolist()
    for time, a, b, up, yaw in zip(
        t.time.tolist(), x.tolist(), y.tolist(), z.tolist(), headings, strict=True
    ):
        if a == a and b == b:
            turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
            pose = {"position": {"x": a, "y": b, "z": up if up == up else 0.0}, "orientation": turn}
            channels.send(
                _topic(t.vehicle_id, "pose"), "foxglove.PoseInFrame", time, {"frame_id": "site", "pose": pose}
            )
            written += 1
    return written


def _batteries(channels: _Channels, t: Trajectory) -> None:
    """Current by the convention of ROS: negative while discharging."""
    sources = (
        ("percentage", "soc", 100.0),
        ("voltage", "battery_voltage", 1.0),
        ("current", "battery_current", -1.0),
    )
    columns = {
        name: (t.floats(column) * factor).tolist() for name, column, factor in sources if t.has(column)
    }
    for i, time in enumerate(t.time.tolist() if columns else []):
        message = {name: values[i] for name, values in columns.items() if values[i] == values[i]}
        if message:
            channels.send(_topic(t.vehicle_id, "battery"), "foxglove.Battery", time, message)


EXPORTER = Exporter("mcap", ".mcap", "MCAP for Foxglove: LocationFix (or poses) and battery as JSON", write)
