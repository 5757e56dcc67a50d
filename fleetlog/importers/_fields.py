"""Fields of a table or JSON object, read by name: what each is, and how its values come to SI."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Profile, Source, has_date
from fleetlog.importers._times import epoch_unit, microseconds
from fleetlog.importers._units import EPOCH_UNITS, KINDS, Meaning, recognise, si_unit


@dataclass
class Fields:
    """What the fields called ``names`` are: ``columns`` of the dataset and their sources; the log's own
    names of its ``time`` (one, or date and time of day), its ``vehicle`` and what is kept as it is."""

    names: list[str]
    profile: Profile
    report: ReadReport
    columns: dict[str, Source] = field(default_factory=dict)
    time: tuple[str, ...] = ()
    epoch: str | None = None  # Unit of a time that counts, where the name or the profile states it
    vehicle: str | None = None
    kept: list[str] = field(default_factory=list)

    @property
    def used(self) -> set[str]:
        """Names in the log that are taken for something."""
        return {*(s.column for s in self.columns.values()), *self.time, self.vehicle or ""}

    def take_profile(self) -> None:
        """What the profile says of names that are there."""
        profile = self.profile
        for target, source in profile.columns.items():
            if source.column not in self.names:
                continue
            if target == "vehicle_id":
                self.vehicle = source.column
            else:
                self.columns[target] = replace(source, sentinels=(*source.sentinels, *profile.sentinels))
            unit = f", from {source.unit.name}" if source.unit else ""
            self.report.recognised[source.column] = f"{target}{unit} (profile)"
        if profile.time and {*profile.time} <= {*self.names}:
            self.time = profile.time
            self.report.recognised |= dict.fromkeys(profile.time, "timestamp (profile)")
        self.epoch = profile.time_format if profile.time_format in EPOCH_UNITS else None

    def take(self, name: str, meaning: Meaning) -> None:
        """Give a recognised field its place, unless that is taken."""
        target = meaning.column
        taken = {"timestamp": self.time, "vehicle_id": self.vehicle}.get(target, target in self.columns)
        if taken:
            if name not in self.used:
                self.report.note(f"{name!r} could be the {target} too; kept under its own name")
            return
        if target == "timestamp":
            self.time, self.epoch = (name,), self.epoch or meaning.epoch
        elif target == "vehicle_id":
            self.vehicle = name
        else:
            self.columns[target] = Source(name, meaning.unit)
        if not meaning.exact:
            self.report.recognised[name] = target + _unit_text(target, meaning)

    def instant(self, value: Any, epoch: str | None = "") -> int:
        """[us] UTC of a text, or of a count in ``epoch`` (None: the likely one); ValueError if it is none."""
        if isinstance(value, str):
            style, text = self.profile.time_format, value.strip()
            dated = style is not None and "%" in style and has_date(style)
            moment = datetime.strptime(text, str(style)) if dated else datetime.fromisoformat(text)
            return microseconds(moment, self.profile.zone)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError("no time")
        unit, likely = self.epoch if epoch == "" else epoch, epoch_unit(value)
        if not (self.profile.time_format or self.profile.time_origin):
            unit = likely if unit in (None, likely) else None
        if unit is None or not abs(value) < 1e19:
            raise ValueError("no time, or one that counts from an unknown start")
        whole = value // 1000 if unit == "ns" and isinstance(value, int) else round(value * EPOCH_UNITS[unit])
        return self.profile.origin + whole


def fields_of(
    names: Iterable[str], profile: Profile | None, report: ReadReport, time: tuple[str, ...] = ()
) -> Fields:
    """What fields are, told to ``report``: the profile's word first, then spelling; ``time`` is known."""
    found = Fields([*names], profile or Profile(), report, time=time)
    found.take_profile()
    meanings = {n: m for n in found.names if n not in found.used and (m := recognise(n))}
    for name, meaning in sorted(meanings.items(), key=lambda item: not item[1].exact):
        found.take(name, meaning)
    found.kept = [n for n in found.names if n not in found.used] if found.profile.keep else []
    return found


def _unit_text(target: str, meaning: Meaning) -> str:
    if target == "timestamp":
        return f", counted in {meaning.epoch}" if meaning.epoch else ""
    if target not in KINDS or target in ("latitude", "longitude"):
        return ""
    if meaning.unit is None:
        return f", no unit in the name, taken as {si_unit(target).name}"
    compass = meaning.unit.name == "compass_deg"
    return ", from degrees of the compass" if compass else f", from {meaning.unit.name}"
