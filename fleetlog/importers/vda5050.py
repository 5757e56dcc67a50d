"""VDA 5050 ``state`` and ``visualization`` messages, one JSON object a line, versions 1.1, 2.x and 3.x.

A line may be the message itself, the message behind its MQTT topic (``mosquitto_sub -v``), or wrapped as
``{"topic": ..., "payload": ...}``.  3.0 renamed ``agvPosition`` to ``mobileRobotPosition``
(``positionInitialized`` to ``localized``) and ``batteryState`` to ``powerSupply`` (``batteryCharge`` to
``stateOfCharge``).
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.errors import FormatError
from fleetlog.importers._open import open_bytes, plural
from fleetlog.importers._report import ReadReport
from fleetlog.importers._rows import NAN, Rows, finite
from fleetlog.importers._times import iso_time
from fleetlog.importers.base import Importer, RawBatch, ReadOptions

LINE_LIMIT = 1 << 22
MOST = 1e300
"""A sum of weights beyond what a float holds is far beyond any load, and refused as that."""
# without quotation marks: a wrapped payload may be a string, with its marks escaped
_MARKS = (b"serialNumber", b"agvPosition", b"mobileRobotPosition", b"batteryState", b"powerSupply")


def sniff(path: Path, head: bytes) -> bool:
    """Whether a JSON line speaks of a serial number, a position or a battery as VDA 5050 does."""
    first = next((line for line in head.splitlines() if b"{" in line), b"")
    return sum(m in first for m in _MARKS) >= 2 or (
        b"/state" in first[:200] and any(m in first for m in _MARKS)
    )


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Positions as rows; the batteries, which come at their own times, as a channel."""
    stream, raw = open_bytes(path, options.report)
    reader = _Reader(options.vehicle, lambda: raw.share)
    number = 0
    with stream:
        while line := stream.readline(LINE_LIMIT):
            number += 1
            reader.positions.attempt(number, reader.line, line, number)
            for rows in (reader.positions, reader.batteries):
                if rows.full:
                    yield rows.take()
    if not reader.positions.total:
        raise FormatError(_nothing(reader), where=path, do="record the topics state and visualization")
    _describe(options.report, reader)
    yield from reader.positions.drain()
    yield from reader.batteries.drain()


class _Reader:
    """Messages to rows; keeps every vehicle's last load, which visualization does not repeat."""

    def __init__(self, vehicle: str | None, share: Any) -> None:
        self.positions = Rows("x", "y", share=share)
        self.batteries = Rows(share=share)
        self.others: Counter[str] = Counter()
        self.versions: Counter[str] = Counter()
        self.facts: dict[str, str] = {}
        """What the factsheet of each vehicle says."""
        self.connections: Counter[str] = Counter()
        self._vehicle = vehicle
        self._payload: dict[str, float] = {}

    def line(self, line: bytes, number: int) -> None:
        """One line of the log."""
        if not line.strip():
            return
        try:
            message = _message(line)
        except (ValueError, RecursionError):
            cut = "" if line.endswith(b"\n") else ", cut off by the end of the file"
            self.positions.reject(
                number, f"the line is no JSON object{cut}", line[:400].decode("utf-8", "replace")
            )
            return
        position = _first(message, "agvPosition", "mobileRobotPosition")
        battery = _first(message, "batteryState", "powerSupply")
        self.versions[str(message.get("version", "?"))[:12]] += 1
        if position is None and battery is None:
            self._other(message)
            return
        try:
            time = iso_time(str(message["timestamp"]))
        except (KeyError, ValueError):
            self.positions.reject(number, "no timestamp in ISO 8601", str(message.get("timestamp")))
            return
        self._take(message, position, battery, time, number)

    def _other(self, message: dict[str, Any]) -> None:
        """A message without motion: the state of a connection, a factsheet, an order."""
        kind = _kind(message)
        self.others[kind] += 1
        if kind == "connection":
            self.connections[str(message["connectionState"])[:20]] += 1
        elif kind == "factsheet" and (facts := _facts(message)):
            self.facts[self._name(message)] = facts

    def _name(self, message: dict[str, Any]) -> str:
        names = (str(message[k]) for k in ("manufacturer", "serialNumber") if message.get(k))
        return self._vehicle or "/".join(names) or "agv"

    def _take(
        self,
        message: dict[str, Any],
        position: dict[str, Any] | None,
        battery: dict[str, Any] | None,
        time: int,
        number: int,
    ) -> None:
        vehicle = self._name(message)
        if isinstance(message.get("loads"), list):
            self._payload[vehicle] = _payload(message["loads"])
        if position is not None:
            values = _pose(position, message.get("velocity"))
            if position.get("positionInitialized") is False or position.get("localized") is False:
                self.positions.reject(number, "the vehicle is not localised", position)
            elif not (math.isfinite(values["x"]) and math.isfinite(values["y"])):
                self.positions.reject(number, "x or y is not a number", position)
            else:
                values["payload"] = self._payload.get(vehicle, NAN)
                values |= _labels(message, position) | _quality(position)
                self.positions.add(vehicle, time, number, values)
        if battery is not None:
            charge = _battery(battery)
            if charge:
                self.batteries.add(vehicle, time, number, charge)


def _message(line: bytes) -> dict[str, Any]:
    begin = line.find(b"{")
    if begin < 0:
        raise ValueError("no object")
    message = json.loads(line[begin:])
    if isinstance(message, dict) and "payload" in message and "timestamp" not in message:
        message = message["payload"]
        message = json.loads(message) if isinstance(message, str) else message
    if not isinstance(message, dict):
        raise ValueError("no object")
    return message


def _first(message: dict[str, Any], *names: str) -> dict[str, Any] | None:
    return next((message[n] for n in names if isinstance(message.get(n), dict)), None)


def _kind(message: dict[str, Any]) -> str:
    marks = {"connectionState": "connection", "nodes": "order", "actions": "instantActions"}
    marks |= {"typeSpecification": "factsheet", "driving": "state without position"}
    for mark, kind in marks.items():
        if mark in message:
            return kind
    return "other"


def _pose(position: dict[str, Any], velocity: Any) -> dict[str, Any]:
    """``theta`` is the contract's heading; the speed is the length of the vehicle's own velocity."""
    values: dict[str, Any] = {"x": finite(position.get("x")), "y": finite(position.get("y"))}
    theta = finite(position.get("theta"))
    values["heading"] = math.remainder(theta, math.tau) if theta == theta else NAN
    values["speed"] = NAN
    if isinstance(velocity, dict) and ("vx" in velocity or "vy" in velocity):
        values["speed"] = math.hypot(finite(velocity.get("vx", 0.0)), finite(velocity.get("vy", 0.0)))
    return values


def _labels(message: dict[str, Any], position: dict[str, Any]) -> dict[str, str]:
    pairs = (
        ("map_id", position.get("mapId")),
        ("order_id", message.get("orderId")),
        ("operating_mode", message.get("operatingMode")),
    )
    return {name: value for name, value in pairs if isinstance(value, str) and value}


def _quality(position: dict[str, Any]) -> dict[str, float]:
    """How well the vehicle knows where it is: a score from 0 to 1, a deviation [m]."""
    pairs = (("localization_score", "localizationScore"), ("deviation_range", "deviationRange"))
    return {name: value for name, key in pairs if (value := finite(position.get(key))) == value}


def _facts(message: dict[str, Any]) -> str:
    """Series, load and speeds of a factsheet, whose names differ between versions 2 and 3."""
    parts = [_first(message, name) or {} for name in ("typeSpecification", "physicalParameters")]
    units = {
        "seriesName": "", "maxLoadMass": " kg", "maximumLoadMass": " kg", "speedMax": " m/s",
        "maximumSpeed": " m/s", "accelerationMax": " m/s2", "maximumAcceleration": " m/s2",
    }  # fmt: skip
    found = {
        k: v for part in parts for k, v in part.items() if k in units and isinstance(v, str | int | float)
    }
    return ", ".join(f"{k} {str(v)[:40]}{units[k]}" for k, v in found.items())


def _payload(loads: list[Any]) -> float:
    """Sum of the weights [kg]; 0 for an empty list, NaN where a load has no weight."""
    total = sum(finite(load.get("weight")) if isinstance(load, dict) else NAN for load in loads)
    return max(min(float(total), MOST), -MOST) if total == total else NAN


def _battery(battery: dict[str, Any]) -> dict[str, Any]:
    charge = finite(battery.get("batteryCharge", battery.get("stateOfCharge"))) / 100.0
    values = {"soc": charge, "battery_voltage": finite(battery.get("batteryVoltage"))}
    # The standard gives the current no sign: it is into the battery while that charges, out of it otherwise.
    current = abs(finite(battery.get("batteryCurrent")))
    values["battery_current"] = -current if battery.get("charging") is True else current
    values["battery_health"] = finite(battery.get("batteryHealth")) / 100.0
    if isinstance(battery.get("charging"), bool):
        values["charging"] = float(battery["charging"])
    return {k: v for k, v in values.items() if v == v}


def _nothing(reader: _Reader) -> str:
    bad = f", {plural(reader.positions.rejected, 'line')} rejected" if reader.positions.rejected else ""
    others = ", ".join(f"{n} {k}" for k, n in reader.others.most_common()) or "none"
    return f"no message with a position (other messages: {others}{bad})"


def _describe(report: ReadReport, reader: _Reader) -> None:
    report.recognised.update(
        {
            "agvPosition / mobileRobotPosition": "x, y from m, heading from rad",
            "velocity": "speed, the length of vx, vy",
            "loads": "payload, the sum of the weights in kg",
            "batteryState / powerSupply": "soc from %, voltage, current (its sign from charging)",
            "manufacturer, serialNumber": "vehicle_id",
        }
    )
    report.note(
        "VDA 5050 version " + ", ".join(f"{v} ({n} messages)" for v, n in reader.versions.most_common(5))
    )
    for vehicle, facts in list(reader.facts.items())[:5]:
        report.note(f"factsheet of {vehicle}: {facts}")
    if reader.connections:
        report.note("connections: " + ", ".join(f"{n} {k}" for k, n in reader.connections.most_common(5)))
    if reader.others:
        report.note("left out: " + ", ".join(f"{n} {k}" for k, n in reader.others.most_common()))


IMPORTER = Importer("vda5050", (".jsonl", ".ndjson", ".json", ".log"), sniff, read, rank=3)
