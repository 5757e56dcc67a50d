"""What the columns of a text log are: names, what each is taken for, and what was decided unasked."""

import re
from collections import Counter
from dataclasses import dataclass, field

from fleetlog.core.columns import BY_NAME
from fleetlog.errors import FormatError, InputError, nearest
from fleetlog.importers._csv_blocks import rows_of
from fleetlog.importers._names import Meaning, normal, recognise
from fleetlog.importers._profile import Profile, Source
from fleetlog.importers._report import ReadReport
from fleetlog.importers._units import KINDS, si_unit

DELIMITERS = ",;\t|"
_COMMA = re.compile(r"[+-]?\d*,\d+")
_POINT = re.compile(r"[+-]?\d*\.\d+")


@dataclass
class Layout:
    """How a log's columns become the dataset's."""

    names: list[str]
    delimiter: str
    skip: int
    """Lines before the first row, the header line among them."""
    vehicle: str | None = None
    time: tuple[str, ...] = ()
    epoch: str | None = None
    """Unit of a time that counts, where the name or the profile states it."""
    values: dict[str, Source] = field(default_factory=dict)
    """Column of the dataset -> where it comes from."""
    labels: dict[str, str] = field(default_factory=dict)
    """Columns of text (edge_id) and the trip number -> where they come from."""
    own: list[str] = field(default_factory=list)
    decimal: str = "."

    @property
    def used(self) -> set[str]:
        """Names in the log that are taken for something."""
        named = {s.column for s in self.values.values()} | set(self.labels.values()) | set(self.time)
        return named | ({self.vehicle} if self.vehicle else set())


def find_delimiter(lines: list[str]) -> str:
    """The separator that splits the header line, and most of the other lines into as many fields as that."""

    def worth(delimiter: str) -> tuple[float, int]:
        counts = [len(row) for row in rows_of(lines, delimiter)]
        fields = counts[0] if counts else 1
        return (counts.count(fields) / len(counts) if fields > 1 else 0.0), fields

    return max(DELIMITERS, key=worth)


def find_decimal(lines: list[str], delimiter: str, report: ReadReport) -> str:
    """The decimal comma where another character separates cells and no figure has a point; noted."""
    if delimiter == ",":
        return "."
    cells = [cell.strip() for row in rows_of(lines, delimiter) for cell in row]
    commas = sum(bool(_COMMA.fullmatch(cell)) for cell in cells)
    if commas == 0 or any(_POINT.fullmatch(cell) for cell in cells):
        return "."
    report.note("figures have a decimal comma")
    return ","


def unique(names: list[str], report: ReadReport) -> list[str]:
    """Names without a name get their number, names that come again a suffix."""
    out: list[str] = []
    for i, raw in enumerate(names):
        name = raw.strip() or f"column_{i + 1}"
        if name in out:
            again = next(n for k in range(2, len(names) + 2) if (n := f"{name}_{k}") not in (*out, *names))
            report.note(f"the header has {name!r} more than once; the later one is called {again!r}")
            name = again
        out.append(name)
    return out


def fit_header(names: list[str], rows: list[list[str]], report: ReadReport) -> list[str]:
    """The header, a name longer or shorter where most rows have one field more or less than it."""
    usual = Counter(len(row) for row in rows).most_common(1)
    fields = usual[0][0] if usual else len(names)
    if fields == len(names) + 1:
        report.note(f"the rows have a field more than the header has names: it is called 'column_{fields}'")
        return [*names, ""]
    if fields == len(names) - 1 and not names[-1].strip():
        report.note("the header ends with a separator that the rows do not have")
        return names[:-1]
    return names


def lay_out(names: list[str], delimiter: str, skip: int, profile: Profile, report: ReadReport) -> Layout:
    """Decide what every column is: the profile first, then the names; ``report`` hears of it all."""
    layout = Layout(unique(names, report), delimiter, skip)
    _from_profile(layout, profile, report)
    meanings = {n: m for n in layout.names if n not in layout.used and (m := recognise(n))}
    _split_time(layout, meanings, report)
    for name, meaning in sorted(meanings.items(), key=lambda item: not item[1].exact):
        _take(layout, name, meaning, report)
    if profile.keep:
        layout.own = [n for n in layout.names if n not in layout.used]
    _check(layout, report)
    return layout


def _from_profile(layout: Layout, profile: Profile, report: ReadReport) -> None:
    for target, source in profile.columns.items():
        _must_have(layout, source.column, f"columns.{target}", profile)
        if target == "vehicle_id":
            layout.vehicle = source.column
        elif BY_NAME.get(target) and BY_NAME[target].kind in ("label", "int64"):
            layout.labels[target] = source.column
        else:
            layout.values[target] = source
        unit = f", from {source.unit.name}" if source.unit else ""
        report.recognised[source.column] = f"{target}{unit} (profile)"
    for name in profile.time:
        _must_have(layout, name, "time.column", profile)
        report.recognised[name] = "timestamp (profile)"
    layout.time = profile.time


def _must_have(layout: Layout, name: str, place: str, profile: Profile) -> None:
    if name not in layout.names:
        what, do = f"the log has no column {name!r}", nearest(name, layout.names)
        raise InputError(what, where=profile.path, place=place, do=do)


def _split_time(layout: Layout, meanings: dict[str, Meaning], report: ReadReport) -> None:
    """A date and a time of day in two columns."""
    if layout.time:
        return
    plain = {normal(n): n for n in layout.names if n not in layout.used}
    date = plain.get("date") or plain.get("day")
    clock = plain.get("time") or plain.get("time_of_day") or plain.get("clock")
    if date and clock and not any(m.column == "timestamp" and m.exact for m in meanings.values()):
        layout.time = (date, clock)
        report.recognised[date], report.recognised[clock] = "timestamp (date)", "timestamp (time of day)"


def _take(layout: Layout, name: str, meaning: Meaning, report: ReadReport) -> None:
    """Give a recognised column its place, unless that is taken."""
    target = meaning.column
    taken = target in layout.values or target in layout.labels
    if taken or (target == "timestamp" and layout.time) or (target == "vehicle_id" and layout.vehicle):
        if name not in layout.used:
            report.note(f"{name!r} could be the {target} too; kept under its own name")
        return
    if target == "timestamp":
        layout.time, layout.epoch = (name,), meaning.epoch
    elif target == "vehicle_id":
        layout.vehicle = name
    elif target in KINDS:
        layout.values[target] = Source(name, meaning.unit)
    else:
        layout.labels[target] = name
    if not meaning.exact:
        report.recognised[name] = target + _unit_text(target, meaning)


def _unit_text(target: str, meaning: Meaning) -> str:
    if target == "timestamp":
        return f", counted in {meaning.epoch}" if meaning.epoch else ""
    if target not in KINDS or target in ("latitude", "longitude"):
        return ""
    if meaning.unit is None:
        return f", no unit in the name, taken as {si_unit(target).name}"
    compass = meaning.unit.name == "compass_deg"
    return ", from degrees of the compass" if compass else f", from {meaning.unit.name}"


def _check(layout: Layout, report: ReadReport) -> None:
    """An error where there is no time or nothing at all that is known."""
    seen = ", ".join(layout.names[:12]) + (" ..." if len(layout.names) > 12 else "")
    if not layout.time:
        do = "name it in a profile: [time] column = ..."
        raise FormatError(f"no time among the columns ({seen})", where=report.path, do=do)
    if not layout.values:
        what = f"no known column beside the time ({seen})"
        raise FormatError(what, where=report.path, do="map the columns in a profile")
