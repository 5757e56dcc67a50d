"""What the columns of a text log are: names, what each is taken for, and what was decided unasked."""

import re
from collections import Counter

from fleetlog.errors import FormatError, InputError, nearest
from fleetlog.importers._csv_blocks import rows_of
from fleetlog.importers._fields import Fields, fields_of
from fleetlog.importers._open import ReadReport
from fleetlog.importers._profile import Profile
from fleetlog.importers._units import KINDS, normal

DELIMITERS = ",;\t|"
_COMMA = re.compile(r"[+-]?\d*,\d+")
_POINT = re.compile(r"[+-]?\d*\.\d+")


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


def lay_out(names: list[str], profile: Profile, report: ReadReport) -> Fields:
    """Decide what every column is; an error where there is no time, or nothing at all that is known."""
    names = unique(names, report)
    for target, source in profile.columns.items():
        _must_have(names, source.column, f"columns.{target}", profile)
    for name in profile.time:
        _must_have(names, name, "time.column", profile)
    fields = fields_of(names, profile, report, _split_time(names, profile, report))
    seen = ", ".join(names[:12]) + (" ..." if len(names) > 12 else "")
    if not fields.time:
        do = "name it in a profile (--profile FILE.toml): [time] column = ..."
        raise FormatError(f"no time among the columns ({seen})", where=report.path, do=do)
    if not fields.columns.keys() & KINDS.keys():
        what = f"no known column beside the time ({seen})"
        raise FormatError(what, where=report.path, do="map the columns in a profile (--profile FILE.toml)")
    return fields


def _must_have(names: list[str], name: str, place: str, profile: Profile) -> None:
    if name not in names:
        what, do = f"the log has no column {name!r}", nearest(name, names)
        raise InputError(what, where=profile.path, place=place, do=do)


def _split_time(names: list[str], profile: Profile, report: ReadReport) -> tuple[str, ...]:
    """A date and a time of day in two columns; nothing where the time is known otherwise."""
    free = [n for n in names if n not in {s.column for s in profile.columns.values()}]
    plain = {normal(n): n for n in free}
    date = plain.get("date") or plain.get("day")
    clock = plain.get("time") or plain.get("time_of_day") or plain.get("clock")
    if profile.time or not date or not clock or "timestamp" in (n.strip() for n in free):
        return ()
    report.recognised[date], report.recognised[clock] = "timestamp (date)", "timestamp (time of day)"
    return date, clock
