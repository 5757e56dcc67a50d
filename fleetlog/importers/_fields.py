"""Fields of a table or JSON object, read by name: what each is, and how its values come to SI."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from fleetlog.importers._names import EPOCH_UNITS, recognise
from fleetlog.importers._profile import Profile, Source, has_date
from fleetlog.importers._report import ReadReport
from fleetlog.importers._times import epoch_unit, microseconds

_PER = {"s": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3}


@dataclass
class Fields:
    """All fields: ``columns`` by the dataset's names; ``time``, ``vehicle``, ``kept`` by the log's."""

    columns: dict[str, Source] = field(default_factory=dict)
    time: str | None = None
    epoch: str | None = None
    vehicle: str | None = None
    kept: list[str] = field(default_factory=list)
    profile: Profile = field(default_factory=Profile)

    def instant(self, value: Any, epoch: str | None = "") -> int:
        """Microseconds UTC of a text, or of a count in ``epoch`` (None: the likely one) from the origin.

        :class:`ValueError` where it is no time.
        """
        if isinstance(value, str):
            return self._of_text(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError("no time")
        unit, likely = self.epoch if epoch == "" else epoch, epoch_unit(value)
        stated = self.profile.time_format or self.profile.time_origin
        if not stated:
            unit = likely if unit in (None, likely) else None
        if unit is None or not abs(value) < 1e19:
            raise ValueError("no time, or one that counts from an unknown start")
        whole = value // 1000 if unit == "ns" and isinstance(value, int) else round(value * _PER[unit])
        return self.profile.origin + whole

    def _of_text(self, text: str) -> int:
        style = self.profile.time_format
        if style is None or "%" not in style or not has_date(style):
            moment = datetime.fromisoformat(text.strip())
        else:
            moment = datetime.strptime(text.strip(), style)
        return microseconds(moment if moment.tzinfo else moment.replace(tzinfo=self.profile.zone or UTC))


def fields_of(names: Iterable[str], profile: Profile | None, report: ReadReport) -> Fields:
    """What the fields called ``names`` are: the profile's word first, then the spelling."""
    found, names = Fields(profile=profile or Profile()), list(names)
    if profile is not None:
        found.time = profile.time[0] if profile.time and profile.time[0] in names else None
        if profile.time_format in EPOCH_UNITS:
            found.epoch = profile.time_format
        for target, source in profile.columns.items():
            if source.column in names:
                missing = (*source.sentinels, *profile.sentinels)
                found.columns[target] = replace(source, sentinels=missing)
    given = {f.column for f in found.columns.values()} | {found.time}
    exact_first = sorted(names, key=lambda n: not ((m := recognise(n)) and m.exact))
    for name in exact_first:
        meaning = None if name in given else recognise(name)
        if meaning is None:
            found.kept += [name] * (name not in given)
        elif meaning.column == "timestamp" and found.time is None:
            found.time, found.epoch = name, found.epoch or meaning.epoch
        elif meaning.column == "vehicle_id" and found.vehicle is None and "vehicle_id" not in found.columns:
            found.vehicle = name
        elif meaning.column not in found.columns and meaning.column not in ("timestamp", "vehicle_id"):
            found.columns[meaning.column] = Source(name, meaning.unit)
        else:
            found.kept.append(name)
    if "vehicle_id" in found.columns:
        found.vehicle = found.columns.pop("vehicle_id").column
    if profile is not None and not profile.keep:
        found.kept = []
    _say(found, report)
    return found


def _say(found: Fields, report: ReadReport) -> None:
    for target, f in found.columns.items():
        if f.column != target or f.unit is not None:
            report.recognised[f.column] = f"{target}, from {f.unit.name}" if f.unit else target
    for name, target in ((found.time, "timestamp"), (found.vehicle, "vehicle_id")):
        if name and name != target:
            report.recognised[name] = target
