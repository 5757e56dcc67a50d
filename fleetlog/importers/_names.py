"""Spellings of columns that are met in logs, and what each is taken for."""

import re
from dataclasses import dataclass

from fleetlog.core.columns import NAMES
from fleetlog.importers._units import KINDS, Unit, find_unit, si_unit

_SPELLINGS: dict[str, str] = {
    "vehicle_id": "vehicle vehicleid id truck truck_id truckid device device_id deviceid agv agv_id asset "
    "asset_id unit_id "
    "forklift forklift_id robot robot_id serial_number serialnumber vehicle_name car_id",
    "timestamp": "time datetime date_time ts utc epoch time_stamp gps_time gpstime utc_time timestamp_utc "
    "time_utc unix_time "
    "unixtime recorded_at created_at",
    "latitude": "lat gps_lat gps_latitude position_lat",
    "longitude": "lon lng long gps_lon gps_lng gps_longitude position_lon position_long",
    "x": "pos_x position_x x_pos",
    "y": "pos_y position_y y_pos",
    "z": "alt altitude elev elevation ele gps_alt gps_altitude pos_z position_z",
    "heading": "yaw theta course cog bearing track course_over_ground",
    "speed": "velocity vehicle_speed gps_speed gpsspeed speed_over_ground sog groundspeed",
    "payload": "load load_weight load_mass",
    "fork_height": "lift_height mast_height forkheight",
    "battery_power": "power pack_power",
    "battery_voltage": "voltage volts volt pack_voltage",
    "battery_current": "current amps amperes pack_current",
    "soc": "state_of_charge battery_soc battery_level battery_charge battery_percentage charge_level",
    "ambient_temperature": "ambient ambient_temp temperature temp outside_temperature outside_temp "
    "air_temperature amb",
}
_BY_SPELLING = {s: name for name, words in _SPELLINGS.items() for s in [name, *words.split()]}
_BY_SPELLING.update({n: n for n in NAMES})
_COMPASS = frozenset(["course", "cog", "bearing", "track", "course_over_ground"])
EPOCH_UNITS: dict[str, int] = {"s": 1_000_000, "ms": 1_000, "us": 1, "ns": -1_000}
"""Microseconds in one unit; a negative figure divides."""
_EPOCH_ALIASES = {"s": "s", "sec": "s", "seconds": "s"} | {
    alias: short
    for short, word in (("ms", "milli"), ("us", "micro"), ("ns", "nano"))
    for alias in (short, f"{short}ec", f"{word}s", f"{word}seconds")
}
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class Meaning:
    """What a column is taken for.

    ``unit`` is None where the name does not say it (then the dataset's unit holds); ``epoch`` is the unit of
    a time that counts from 1970, where the name says it.
    """

    column: str
    unit: Unit | None = None
    epoch: str | None = None
    exact: bool = False  # Whether it is spelt as the contract spells it


def normal(name: str) -> str:
    """Lower case, joined by underscores: ``Battery Power``, ``batteryPower`` give ``battery_power``."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", "_", name.strip())
    return re.sub(r"[^0-9a-z]+", "_", spaced.lower()).strip("_")


def recognise(name: str) -> Meaning | None:
    """What the column called ``name`` is, or None where its name does not say."""
    bracket = _BRACKETS.match(name)
    if bracket:
        return _with_unit(normal(bracket[1]), bracket[2])
    whole = normal(name)
    if whole in _BY_SPELLING:
        return _plain(whole, exact=name.strip() == whole == _BY_SPELLING[whole])
    for cut in reversed([i for i, c in enumerate(whole) if c == "_"]):
        meaning = _with_unit(whole[:cut], whole[cut + 1 :])
        if meaning and (meaning.unit or meaning.epoch):
            return meaning
    return None


def _plain(spelling: str, *, exact: bool = False) -> Meaning:
    column = _BY_SPELLING[spelling]
    unit = find_unit("compass_deg", "angle") if spelling in _COMPASS else None
    return Meaning(column, unit, exact=exact)


def _with_unit(spelling: str, text: str) -> Meaning | None:
    column = _BY_SPELLING.get(spelling)
    if column is None:
        return None
    if column == "timestamp":
        epoch = _EPOCH_ALIASES.get(normal(text))
        known = epoch or normal(text) in ("", "utc", "iso", "iso_8601")
        return Meaning(column, epoch=epoch) if known else None
    if column not in KINDS or not text:
        return Meaning(column) if not text else None
    if spelling in _COMPASS:
        return _plain(spelling) if normal(text) in ("deg", "degrees", "") or text == "°" else None
    if spelling == "heading" and find_unit(text, "angle") != si_unit("heading"):
        return None  # degrees of the compass or of mathematics: the name does not tell
    unit = find_unit(text, KINDS[column])
    return Meaning(column, unit) if unit else None
