"""MCAP with JSON channels that Foxglove draws: ``/ID/fix`` (foxglove.LocationFix) or, without a place on
earth, ``/ID/pose`` (foxglove.PoseInFrame), and ``/ID/battery`` where the dataset knows it."""

import json
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.site import Frame
from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Selection
from fleetlog.version import __version__

SCHEMAS: dict[str, Any] = json.loads(Path(__file__).with_name("foxglove.json").read_text(encoding="utf-8"))
TOPICS = {"LocationFix": "fix", "PoseInFrame": "pose", "Battery": "battery"}
_BATTERY = (
    ("percentage", "soc", 100.0), ("voltage", "battery_voltage", 1.0), ("current", "battery_current", -1.0),
)  # fmt: skip
Message = tuple[str, int, dict[str, Any]]  # Schema, time [us] and content


def write(selection: Selection, path: Path) -> None:
    """Vehicle by vehicle; readers sort by time through the index."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library=f"fleetlog {__version__}")

        @cache
        def schema(kind: str) -> int:
            text = json.dumps(SCHEMAS[kind])
            return int(writer.register_schema(SCHEMAS[kind]["title"], "jsonschema", text.encode()))

        @cache
        def channel(vehicle: str, kind: str) -> int:
            topic = f"/{vehicle.strip('/').replace('/', '_')}/{TOPICS[kind]}"
            return int(writer.register_channel(topic, "json", schema(kind)))

        for t in selection.days():
            places = _places(selection.placed(t), selection.dataset.site.frame)
            for kind, time, content in chain(places, _batteries(t)):
                stamp = {"sec": time // 1_000_000, "nsec": time % 1_000_000 * 1000}
                data = json.dumps({"timestamp": stamp, **content}, allow_nan=False).encode()
                writer.add_message(channel(t.vehicle_id, kind), time * 1000, data, time * 1000)
        writer.finish()


def _places(t: Trajectory, frame: Frame | None) -> Iterator[Message]:
    """Fixes, or without a place on earth poses."""
    x, y, z, half = (t.floats(c) for c in ("x", "y", "z", "heading"))
    if frame is not None:
        columns = [t.time, *frame.to_geographic(x, y), z]
        for time, latitude, longitude, up in zip(*(c.tolist() for c in columns), strict=True):
            height = {"altitude": up} if up == up else {}
            fix = {"frame_id": "site", "latitude": latitude, "longitude": longitude, **height}
            yield "LocationFix", time, fix
        return
    half = np.nan_to_num(half) / 2
    columns = [t.time, x, y, np.nan_to_num(z), np.sin(half), np.cos(half)]
    for time, east, north, up, s, c in zip(*(v.tolist() for v in columns), strict=True):
        turn = {"x": 0.0, "y": 0.0, "z": s, "w": c}
        pose = {"position": {"x": east, "y": north, "z": up}, "orientation": turn}
        yield "PoseInFrame", time, {"frame_id": "site", "pose": pose}


def _batteries(t: Trajectory) -> Iterator[Message]:
    """Current by the convention of ROS: negative while discharging."""
    columns = {n: (t.floats(c) * factor).tolist() for n, c, factor in _BATTERY if t.has(c)}
    for time, *row in zip(t.time.tolist(), *columns.values(), strict=True):
        if known := {name: value for name, value in zip(columns, row, strict=True) if value == value}:
            yield "Battery", time, known
