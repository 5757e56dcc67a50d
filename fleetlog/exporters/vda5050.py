"""VDA 5050 ``state`` messages, one JSON object a line, as version 3.0 writes them: a stand-in for a fleet.

Every row is a message of its vehicle; what a dataset cannot know (orders, actions, errors) is empty, and
without a state of charge, which the standard requires, there is no power supply.  Lost are ambient
temperature, fork height, power and the log's own columns."""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.core.trajectory import Trajectory
from fleetlog.exporters.base import Selection

COLUMNS = (
    "x", "y", "heading", "speed", "payload", "soc", "battery_voltage", "battery_current", "map_id",
    "order_id",
)  # fmt: skip
DRIVING = 0.05  # A truck faster than this drives [m/s]


def write(selection: Selection, path: Path) -> None:
    """Vehicle by vehicle; the name before a slash is the manufacturer's."""
    header: Counter[str] = Counter()
    with path.open("w", encoding="utf-8") as out:
        for t in map(selection.placed, selection.days(COLUMNS)):
            for message in _messages(t, header[t.vehicle_id]):
                out.write(json.dumps(message, allow_nan=False, separators=(",", ":")) + "\n")
            header[t.vehicle_id] += len(t)


def _messages(t: Trajectory, first: int) -> Iterator[dict[str, Any]]:
    maker, _, serial = t.vehicle_id.rpartition("/")
    stamps = np.datetime_as_string(t.time.view("datetime64[us]"), unit="ms").tolist()
    numbers = {n: t.floats(n).tolist() for n in COLUMNS[:8]}
    maps, orders = (t.labels(n).strings() for n in ("map_id", "order_id"))
    fixed = {"version": "3.0.0", "manufacturer": maker or "fleetlog", "serialNumber": serial}
    for i, stamp in enumerate(stamps):
        row = {n: v[i] for n, v in numbers.items()}
        yield {
            "headerId": first + i, "timestamp": f"{stamp}Z", **fixed, "orderId": orders[i] or "",
            "orderUpdateId": 0, "lastNodeId": "", "lastNodeSequenceId": 0, "nodeStates": [], "edgeStates": [],
            **_state(row, maps[i] or "site"), "actionStates": [], "instantActionStates": [],
            "operatingMode": "AUTOMATIC", "errors": [],
            "safetyState": {"activeEmergencyStop": "NONE", "fieldViolation": False},
        }  # fmt: skip


def _state(row: dict[str, float], map_id: str) -> dict[str, Any]:
    """Position, velocity, loads and power supply; what is unknown and not required is left out."""
    known = {n: v for n, v in row.items() if v == v}
    place = {"x": row["x"], "y": row["y"], "theta": known.get("heading", 0.0)}
    position = {**place, "mapId": map_id, "localized": True}
    out: dict[str, Any] = {"mobileRobotPosition": position, "driving": known.get("speed", 0.0) > DRIVING}
    if "speed" in known:
        out["velocity"] = {"vx": known["speed"], "vy": 0.0, "omega": 0.0}
    if "payload" in known:
        out["loads"] = [{"weight": known["payload"]}] if known["payload"] > 0.0 else []
    if "soc" in known:
        current, voltage = known.get("battery_current"), known.get("battery_voltage")
        supply = {"stateOfCharge": 100.0 * known["soc"], "charging": (current or 0.0) < 0.0}
        supply |= {} if voltage is None else {"batteryVoltage": voltage}
        out["powerSupply"] = supply | ({} if current is None else {"batteryCurrent": abs(current)})
    return out
