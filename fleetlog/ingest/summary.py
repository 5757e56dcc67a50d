"""What an import did, as figures and as lines for a person."""

import tomllib
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fleetlog.core.words import count, listed, reasons, wrong_sign
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE
from fleetlog.importers._open import ReadReport
from fleetlog.ingest.clean import JUMP
from fleetlog.ingest.derive import suspect_unit
from fleetlog.ingest.rows import Rejects
from fleetlog.store.trips import Columns, contents_of, trips_of

MOST_PACES = 50
DERIVED, NOTES = tomllib.loads(Path(__file__).with_name("notes.toml").read_text("utf-8")).values()


@dataclass
class ImportSummary:
    """Counts add up: ``rows_read = rows + rows_rejected + rows_joined``."""

    files: list[ReadReport] = field(default_factory=list)
    vehicles: dict[str, int] = field(default_factory=dict)  # Rows in the dataset by vehicle
    start: str | None = None
    end: str | None = None
    rows_read: int = 0
    rows: int = 0
    rows_joined: int = 0  # Without a position (battery messages), whose values went onto rows with one
    rejected: dict[str, int] = field(default_factory=dict)  # Rows refused, by reason
    rejected_values: dict[str, int] = field(default_factory=dict)
    """Single values refused (set unknown; the row stayed), by reason."""
    rejected_file: str | None = None
    derived: list[str] = field(default_factory=list)  # Columns made from others
    derived_by_vehicle: dict[str, list[str]] = field(default_factory=dict)
    """The same by vehicle: what was derived is no channel that a diagnosis may test."""
    filled: dict[str, int] = field(default_factory=dict)
    """By column, how many values that the log lacks among its own were made from others."""
    notes: list[str] = field(default_factory=list)
    alignment: dict[str, Any] | None = None  # The frame that was fitted to the roads, its residual and doubt
    trips: int = 0
    matched: float | None = None  # Share of the rows on a road; None without a map
    off_map: dict[str, int] = field(default_factory=dict)  # Rows without a road, by reason

    @property
    def rows_rejected(self) -> int:
        """Rows refused, in all."""
        return sum(self.rejected.values())

    @property
    def damaged(self) -> bool:
        """Whether anything was damaged or refused."""
        return bool(self.rejected or self.rejected_values or any(f.damage for f in self.files))

    @property
    def exit_status(self) -> int:
        """0, or 3 where some of the data were damaged or refused."""
        return EXIT_DAMAGED if self.damaged else EXIT_DONE

    def to_dict(self) -> dict[str, Any]:
        """As ``--json`` prints it."""
        files = [f.to_dict() for f in self.files]
        return {**asdict(self), "files": files, "rows_rejected": self.rows_rejected, "damaged": self.damaged}

    def lines(self) -> list[str]:
        """For a person."""
        out = _file_lines(self.files)
        if self.rows:
            whose = f"{count(len(self.vehicles), 'vehicle')}, {count(self.trips, 'trip')}"
            first, last = (str(t)[:19].replace("T", " ") for t in (self.start, self.end))
            out.append(f"{count(self.rows, 'row')} of {whose}, {first} to {last} UTC")
        if self.rows_joined:
            out.append(f"{self.rows_joined:,} rows without a position were joined to those with one")
        if self.derived:
            out.append(f"derived: {', '.join(self.derived)}")
        if self.matched is not None:
            off = f" (the others: {reasons(self.off_map)})" if self.off_map else ""
            out.append(f"{100 * self.matched:.1f} % of the rows are on a road{off}")
        out += self.notes
        for what, counts in (("rejected rows", self.rejected), ("rejected values", self.rejected_values)):
            if counts:
                out.append(f"{what}: {sum(counts.values()):,} ({reasons(counts)})")
        if self.rejected_file:
            out.append(f"what was rejected is kept in {self.rejected_file}")
        return out


def _file_lines(files: list[ReadReport]) -> list[str]:
    """Of every file; files that tell the same are told once."""
    groups: dict[str, list[ReadReport]] = defaultdict(list)
    for f in files:
        notes = [n.replace(Path(f.file).stem, "FILE") for n in f.notes]
        groups[repr((f.format, f.recognised, notes, f.damage))].append(f)
    out = []
    for one, *more in groups.values():
        name = f"{one.file} and {count(len(more), 'more file')}" if more else one.file
        out.append(f"{name}: {one.format}, {count(sum(f.rows for f in (one, *more)), 'row')}")
        out += [f"  {source} is {meaning}" for source, meaning in one.recognised.items()]
        out += [f"  {note}" for note in one.notes]
        out += [f"  damaged: {text}" for text in one.damage]
    return out


@dataclass
class Outcome:
    """What the import of a vehicle came to."""

    rejects: Rejects
    pieces: list[Columns] = field(default_factory=list)  # Of its trips
    columns: dict[str, str] = field(default_factory=dict)  # The unit of every column
    counts: Counter[str] = field(default_factory=Counter)
    """Rows ``joined``, ``driven`` with a power, ``fast``, ``matched``, ``on_road``, with edges ``kept``,
    of a ``stuck`` sensor, ``held`` at a repeated position, with x, y of an ``other_frame``."""
    off_map: Counter[str] = field(default_factory=Counter)  # Rows without a road, by reason
    derived: dict[str, list[str]] = field(default_factory=dict)  # Columns made from others, by vehicle
    filled: Counter[str] = field(default_factory=Counter)  # Single values made from others, by column
    driven_power: dict[str, float] = field(default_factory=dict)  # Sum of rows that drive [W], by vehicle
    paces: list[float] = field(default_factory=list)  # Speeds of the log over those of its positions
    readings: dict[str, str] = field(default_factory=dict)  # By vehicle, how its headings would fit the way


def complete(summary: ImportSummary, outcomes: Sequence[Outcome]) -> None:
    """Add what the vehicles came to, in their order, to the summary of what was read."""
    counts = sum((o.counts for o in outcomes), Counter[str]())
    pieces = [piece for o in outcomes for piece in o.pieces]
    summary.vehicles, summary.start, summary.end = contents_of(pieces)
    summary.rows, summary.trips = sum(summary.vehicles.values()), len(trips_of(pieces))
    summary.rows_joined = counts["joined"]
    summary.off_map = dict(sum((o.off_map for o in outcomes), Counter[str]()))
    summary.derived_by_vehicle = {vehicle: made for o in outcomes for vehicle, made in o.derived.items()}
    summary.derived = sorted({name for made in summary.derived_by_vehicle.values() for name in made})
    paces = [] if "speed" in summary.derived else [p for o in outcomes for p in o.paces]
    filled = sum((o.filled for o in outcomes), Counter[str]())
    summary.filled = dict(sorted((+filled).items()))
    why = "(unknown in the log, or rejected)"
    summary.notes += [f"{count(n, *DERIVED[name])} {why}" for name, n in summary.filled.items()]
    jumps = counts["fast"] + sum(o.rejects.rows[JUMP] for o in outcomes)
    counts["jumps"] = jumps * (jumps > summary.rows // 10)  # those of a receiver are single rows
    found: dict[str, tuple[Any, ...]] = {kind: (number,) for kind, number in counts.items() if number}
    watts = sum(sum(o.driven_power.values()) for o in outcomes) / max(counts["driven"], 1)
    if 0.0 < watts < 10.0:  # standing, a small vehicle's electronics alone take more
        found["weak"] = (watts,)
    if unit := suspect_unit(paces[:MOST_PACES]):
        found["pace"] = unit[::-1]
    summary.notes += [text.format(*found[kind]) for kind, text in NOTES.items() if kind in found]
    for reading in sorted({r for o in outcomes for r in o.readings.values()}):
        whose = listed([v for o in outcomes for v, r in o.readings.items() if r == reading])
        summary.notes.append(NOTES["reading"].format(whose, reading))
    if turned := [v for o in outcomes for v, power in o.driven_power.items() if power < 0.0]:
        summary.notes.append(wrong_sign(turned))
    if counts["matched"]:
        summary.matched = counts["on_road"] / counts["matched"]


def added_up(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The summary of a dataset to which another import was added: counts add up, lists go on."""
    out = {key: added(old.get(key), value) for key, value in new.items()}
    rows = [s.get("rows", 0) if s.get("matched") is not None else 0 for s in (old, new)]
    if all(rows):
        out["matched"] = (old["matched"] * rows[0] + new["matched"] * rows[1]) / sum(rows)
    if spans := [s for s in (old, new) if s.get("start") is not None]:
        out["start"], out["end"] = min(s["start"] for s in spans), max(s["end"] for s in spans)
    return out


def added(old: Any, new: Any) -> Any:
    """Two values of one key of a summary as one: counts add up, lists go on, unknown adds nothing."""
    if isinstance(new, dict) and isinstance(old, dict):
        return {key: added(old.get(key), new.get(key)) for key in {**old, **new}}
    if isinstance(new, list) and isinstance(old, list):
        return [*old, *(v for v in new if v not in old)]
    if old is None or new is None:
        return old if new is None else new
    if isinstance(new, bool):
        return new or old
    return old + new if isinstance(new, int) else new
