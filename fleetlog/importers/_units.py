"""Units of logs and their way to SI; names of columns and what they mean."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetlog.core.arrays import Floats
from fleetlog.core.columns import NAMES
from fleetlog.errors import InputError, nearest


@dataclass(frozen=True)
class Unit:
    """``si = (value + shift) * factor``; ``kind`` is the quantity it measures."""

    name: str
    kind: str
    factor: float = 1.0
    shift: float = 0.0

    def to_si(self, values: Floats) -> Floats:
        """Values in SI; angles within -pi and pi, compass angles turned into the site's sense."""
        if self.name == "compass_deg":
            values = 90.0 - values
        if self.name == "ddmm":
            whole = np.trunc(values / 100.0)  # dddmm.mmmm, as NMEA 0183 has it
            values = whole + (values - 100.0 * whole) / 60.0
        out = values if (self.factor, self.shift) == (1.0, 0.0) else (values + self.shift) * self.factor
        if self.kind == "angle" and self.name != "rad":
            out = np.pi - np.mod(np.pi - out, 2 * np.pi)
        return np.asarray(out, dtype=np.float64)


_TEXT = tomllib.loads(Path(__file__).with_name("spellings.toml").read_text(encoding="utf-8"))
UNITS = tuple(Unit(name, kind, *si) for kind, units in _TEXT["si"].items() for name, si in units.items())
_ALIASES = {alias: name for name, words in _TEXT["units"].items() for alias in words.split()}

KINDS = {column: kind for kind, names in _TEXT["measure"].items() for column in names.split()}
"""What each numeric column measures."""


def find_unit(text: str, kind: str) -> Unit | None:
    """The unit that ``text`` spells for a quantity, or None."""
    text = text.strip()
    spelt = {text, _ALIASES.get(text.lower(), text), _ALIASES.get(re.sub(r"\W+", "_", text.lower()), text)}
    return next((u for u in UNITS if u.kind == kind and u.name in spelt), None)


def unit(text: str, column: str, where: str | None = None) -> Unit:
    """The unit that a user wrote for ``column``; :class:`InputError` names those that it can have."""
    kind = KINDS[column]
    if (found := find_unit(text, kind)) is None:
        do = nearest(text, [u.name for u in UNITS if u.kind == kind])
        raise InputError(f"{text!r} is no unit of {kind}", where=where, place=column, do=do)
    return found


def si_unit(column: str) -> Unit:
    """The unit that the dataset has for ``column``."""
    return next(u for u in UNITS if (u.kind, u.factor, u.shift) == (KINDS[column], 1.0, 0.0))


_BY_SPELLING = {s: name for name, words in _TEXT["columns"].items() for s in [name, *words.split()]}
_BY_SPELLING.update({n: n for n in NAMES})
_COMPASS = frozenset(["course", "cog", "bearing", "track", "course_over_ground"])
EPOCH_UNITS = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3}  # Microseconds in one unit
_EPOCH_ALIASES = {alias: name for name, words in _TEXT["epoch"].items() for alias in words.split()}
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class Meaning:
    """What a column is taken for. ``unit`` is None where the name does not say it (then the dataset's unit
    holds); ``epoch`` is the unit of a time that counts from 1970, where the name says it."""

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
    if bracket := _BRACKETS.match(name):
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
    return Meaning(column, find_unit("compass_deg", "angle") if spelling in _COMPASS else None, exact=exact)


def _with_unit(spelling: str, text: str) -> Meaning | None:
    if (column := _BY_SPELLING.get(spelling)) is None:
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
