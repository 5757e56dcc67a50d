"""VDA 5050 ``state`` and ``visualization`` messages, one JSON object a line, versions 1.1, 2.x and 3.x.

A line is a message, alone or behind its topic (``mosquitto_sub -v``), or ``{"topic": ..., "payload": ...}``.
Version 3.0 renamed ``agvPosition``, ``positionInitialized``, ``batteryState`` and ``batteryCharge``."""

import json
import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fleetlog.core.words import count
from fleetlog.importers._profile import Fields, Profile
from fleetlog.importers._rows import NAMES, NAN, Records, finite
from fleetlog.importers.base import LOCAL, Importer, ReadOptions
from fleetlog.importers.geojson import features

Message = dict[str, Any]
MOST = 1e300  # A sum of weights beyond what a float holds is far beyond any load, and refused as that
# without quotation marks: a wrapped payload may be a string, with its marks escaped
_MARKS = (b"serialNumber", b"agvPosition", b"mobileRobotPosition", b"batteryState", b"powerSupply")
_KINDS: dict[str, str] = NAMES["vda5050"]
_FACTS: dict[str, str] = NAMES["factsheet"]


def sniff(path: Path, head: bytes) -> bool:
    """Whether a JSON line speaks of a serial number, a position or a battery as VDA 5050 does."""
    first = next((line for line in head.splitlines() if b"{" in line), b"")
    first = head if first.strip() == b"{" else first  # Objects of several lines
    return sum(m in first for m in _MARKS) >= (1 if b"/state" in first[:200] else 2)


class _Vda(Records):
    """Positions as rows, batteries as a channel. Keeps a vehicle's last load: visualization has none."""

    places, longest = (LOCAL, ()), 1 << 22

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self.versions: Counter[str] = Counter()
        self.facts: dict[str, str] = {}  # What the factsheet of each vehicle says
        self.connections: Counter[str] = Counter()
        self._payload: dict[str, float] = {}
        self._clock = Fields([], options.profile or Profile(), self.report)
        self._degrees, self._most = False, 0.0  # Whether theta is no radians; the highest state of charge

    def records(self) -> Iterable[Any]:
        start = self.stream.peek(64).lstrip(b"\xef\xbb\xbf \t\r\n")
        if start[:1] == b"[" or start.split(b"\n", 1)[0].strip() == b"{":
            return (json.dumps(o).encode() for o in features(self.stream, self.report))
        return super().records()

    def take(self, line: bytes, number: int) -> None:
        if not line.strip():
            return
        try:
            message = _message(line)
        except (ValueError, RecursionError):
            cut = "" if line.endswith(b"\n") else ", cut off by the end of the file"
            self.rows.reject(number, f"the line is no JSON object{cut}", str(line[:400], "utf-8", "replace"))
            return
        position = _first(message, "agvPosition", "mobileRobotPosition")
        battery = _first(message, "batteryState", "powerSupply")
        self.versions[str(message.get("version", "?"))[:12]] += 1
        if position is None and battery is None:
            self._other(message)
            return
        stamp: Any = message.get("timestamp")
        try:
            time = self._clock.instant(int(stamp) if str(stamp).isdigit() else stamp, None)
        except (ValueError, OverflowError):
            self.rows.reject(number, "no timestamp in ISO 8601, or that counts from 1970", str(stamp))
            return
        vehicle = self._name(message)
        if isinstance(loads := message.get("loads"), list):  # a load without a weight: the sum is unknown
            total = float(sum(finite(x.get("weight")) if isinstance(x, dict) else NAN for x in loads))
            self._payload[vehicle] = max(min(total, MOST), -MOST) if total == total else NAN
        if position is not None:
            if any(position.get(name) is False for name in ("positionInitialized", "localized")):
                self.rows.reject(number, "the vehicle is not localised", position)
            else:
                values = self._pose(position, message.get("velocity"))
                values["payload"] = self._payload.get(vehicle, NAN)
                self.rows.add(vehicle, time, number, values | _said(message, position), position)
        if battery is not None and (charge := _battery(battery)):
            self._most = max(self._most, charge.get("soc", 0.0))
            self.tables[1].add(vehicle, time, number, charge)

    def _pose(self, position: dict[str, Any], velocity: Any) -> dict[str, Any]:
        """``theta`` is the contract's heading; the speed is the length of the vehicle's own velocity."""
        values, theta = {name: finite(position.get(name)) for name in LOCAL}, finite(position.get("theta"))
        self._degrees |= abs(theta) > math.tau + 1e-3
        values |= {"theta_log": theta} if self._degrees else {"heading": math.remainder(theta, math.tau)}
        values["speed"] = NAN
        if isinstance(velocity, dict) and ("vx" in velocity or "vy" in velocity):
            values["speed"] = math.hypot(finite(velocity.get("vx", 0.0)), finite(velocity.get("vy", 0.0)))
        return values

    def _other(self, message: Message) -> None:
        """A message without motion: the state of a connection, a factsheet, an order."""
        kind = next((kind for mark, kind in _KINDS.items() if mark in message), "other")
        self.seen[kind] += 1
        if kind == "connection":
            self.connections[str(message["connectionState"])[:20]] += 1
        elif kind == "factsheet" and (facts := _facts(message)):
            self.facts[self._name(message)] = facts

    def _name(self, message: Message) -> str:
        names = (str(message[k]) for k in ("manufacturer", "serialNumber") if message.get(k))
        return self.options.vehicle or "/".join(names) or "agv"

    def nothing(self) -> tuple[str, str]:
        first = next((f", the first for: {r.reason}" for r in self.rows.take().rejects), "")
        bad = f", {count(self.rows.rejected, 'line')} rejected{first}" if first else ""
        what = f"no message with a position (other messages: {_counts(self.seen) or 'none'}{bad})"
        return what, "record the topics state and visualization"

    def describe(self) -> None:
        super().describe()
        versions = (f"{v} ({n} messages)" for v, n in self.versions.most_common(5))
        self.report.note(f"VDA 5050 version {', '.join(versions)}")
        for vehicle, facts in list(self.facts.items())[:5]:
            self.report.note(f"factsheet of {vehicle}: {facts}")
        if self._degrees:
            self.report.note("theta goes beyond a turn of radians: kept as theta_log from there on")
        if 0.0 < self._most <= 0.01:
            self.report.note("no charge is above 1 %: if the robots write shares, soc is 100 times too small")
        for what, kinds in (("connections", self.connections), ("left out", self.seen)):
            if kinds:
                self.report.note(f"{what}: {_counts(kinds, 6)}")


def _counts(kinds: Counter[str], most: int | None = None) -> str:
    return ", ".join(f"{n} {k}" for k, n in kinds.most_common(most))


def _message(line: bytes) -> dict[str, Any]:
    begin = line.find(b"{")
    if begin < 0:
        raise ValueError("no object")
    message = json.loads(line[begin:])
    wrapped = message.get("payload", message.get("message")) if isinstance(message, dict) else None
    wrapped = json.loads(wrapped) if isinstance(wrapped, str) and wrapped.startswith("{") else wrapped
    message = wrapped if isinstance(wrapped, dict) and "serialNumber" not in message else message
    if not isinstance(message, dict):
        raise ValueError("no object")
    return message


def _first(message: Message, *names: str) -> dict[str, Any] | None:
    return next((message[n] for n in names if isinstance(message.get(n), dict)), None)


def _said(message: Message, position: dict[str, Any]) -> dict[str, Any]:
    """Map, order, mode; how well the vehicle knows where it is: a score from 0 to 1, a deviation [m]."""
    texts = {"map_id": position.get("mapId"), "order_id": message.get("orderId")}
    texts["operating_mode"] = message.get("operatingMode")
    pairs = (("localization_score", "localizationScore"), ("deviation_range", "deviationRange"))
    known = {name: value for name, key in pairs if (value := finite(position.get(key))) == value}
    return {name: text for name, text in texts.items() if isinstance(text, str) and text} | known


def _facts(message: Message) -> str:
    """Series, load and speeds of a factsheet."""
    given = (_first(message, "typeSpecification") or {}) | (_first(message, "physicalParameters") or {})
    known = {k: v for k, v in given.items() if k in _FACTS and isinstance(v, str | int | float)}
    return ", ".join(f"{k} {str(v)[:40]}{_FACTS[k]}" for k, v in known.items())


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


IMPORTER = Importer("vda5050", (".jsonl", ".ndjson", ".json", ".log"), sniff, _Vda.batches, rank=3)
