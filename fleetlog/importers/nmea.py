"""NMEA 0183 logs, also with binary bytes and u-blox UBX messages between the sentences.

All sentences of one moment make one fix, whatever talker they come from.  Dates come from RMC, ZDA and
NAV-PVT; a fix before the first date gets it in hindsight.  Broken sentences are rejected and counted; other
ships' AIS messages are left out."""

from collections.abc import Iterator
from io import BufferedReader, BytesIO
from pathlib import Path

from fleetlog.core.arrays import DAY
from fleetlog.core.words import count
from fleetlog.importers._nmea import RANKS, Part, decode, frames, kind_of
from fleetlog.importers._rows import Records
from fleetlog.importers.base import Importer, ReadOptions

WAITING = 1 << 18  # Fixes that may wait for the first date
_AIS = ("VDM", "VDO")


def sniff(path: Path, head: bytes) -> bool:
    """Whether something framed has a right checksum, and most of it is right."""
    good = bad = 0
    for _, frame, fault in frames(BufferedReader(BytesIO(head))):
        kind = kind_of(frame)
        good += fault is None and (kind[:3] == "UBX" or b"*" in frame or kind[-3:] in ("GGA", "RMC"))
        bad += fault is not None
    return (good > 0 and (good >= bad or path.suffix.lower() in IMPORTER.suffixes)) or bad > 2 * good > 0


class _Nmea(Records):
    """One row a moment with a fix; ``ais`` sentences are other ships', ``unchecked`` have no checksum."""

    ais = unchecked = no_fix = 0

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path, options)
        self.waiting: list[Part] = []  # Fixes before the first date
        self._open = Part()
        self._last: Part | None = None  # The last fix with a date

    def records(self) -> Iterator[tuple[int, bytes, str | None]]:
        yield from frames(self.stream)
        self._close()

    def take(self, found: tuple[int, bytes, str | None], _: int) -> None:
        line, frame, fault = found
        kind = kind_of(frame)
        if kind[0] == "!" or kind[-3:] in _AIS:
            self.ais += 1
            return
        unchecked = kind[:3] != "UBX" and b"*" not in frame
        if fault is None and unchecked and self.seen and not self.unchecked:
            fault = "the sentence has no checksum, unlike those before it"
        if fault is None:
            self.unchecked += unchecked
            self.seen[kind] += 1
            try:
                self._add(decode(frame, line))
            except (ValueError, OverflowError) as error:
                fault = f"{kind}: {error}"
        if fault is not None:
            self.rows.reject(line, fault, kind if kind[:3] == "UBX" else frame.decode().strip())

    def _add(self, part: Part) -> None:
        """A new time of day closes the fix before it."""
        if self._open.tod >= 0 and part.tod not in (-1, self._open.tod):
            self._close()
        fix = self._open
        fix.line = fix.line or part.line
        fix.tod, fix.day = max(fix.tod, part.tod), part.day or fix.day
        fix.valid = fix.valid if part.valid is None else part.valid or bool(fix.valid)
        fix.values = fix.values | part.values if part.rank > fix.rank else part.values | fix.values
        fix.rank = max(fix.rank, part.rank)

    def _close(self) -> None:
        """End the current fix; the first with a date gives one to those before it, from the last back."""
        fix, self._open, last = self._open, Part(), self._last
        if fix.tod < 0:
            return
        if last is not None and not fix.day:
            fix.day = last.day + (last.tod - fix.tod > DAY // 2)
        if not fix.day:
            if fix.placed and len(self.waiting) < WAITING:
                self.waiting.append(fix)
            return
        self._last = later = fix
        for early in reversed(self.waiting):
            early.day = later.day - (early.tod - later.tod > DAY // 2)
            later = early
        for known in (*self.waiting, fix):
            if known.placed:
                self.rows.add(self.vehicle, known.day * DAY + known.tod, known.line, known.values)
            else:
                self.no_fix += 1
        self.waiting.clear()

    def nothing(self) -> tuple[str, str]:
        if self.waiting:
            what = f"{count(len(self.waiting), 'position')} with a time of day but no date"
            return f"{what} (no RMC or ZDA sentence with one)", "record RMC or ZDA as well"
        do = "record RMC or GGA sentences or UBX NAV-PVT"
        if self.no_fix:
            return f"the receiver had no fix in any of its {count(self.no_fix, 'moment')}", do
        if self.ais and not self.seen:
            return f"only AIS: {count(self.ais, 'message')} of ships, no position of the receiver", do
        found = ", ".join(f"{n} {k}" for k, n in self.seen.most_common(8)) or "none"
        first, why = self.rows.take().rejects[:1], ""
        if first:
            why = f"; {self.rows.rejected} rejected, the first on line {first[0].record}: {first[0].reason}"
        return f"no sentence with a position (readable sentences: {found}){why}", do

    def describe(self) -> None:
        sources = sorted(k for k in self.seen if k[-3:] in RANKS or k == "UBX-0107")
        meaning = "position, time, speed from knots, heading from course, z above sea level"
        self.report.recognised[", ".join(sources)] = meaning
        self.report.tally(self.no_fix, "moment", "without a fix left out")
        self.report.tally(len(self.waiting), "position", "without a date left out")
        self.report.tally(self.ais, "AIS message", "of other ships left out")
        self.report.tally(self.unchecked, "sentence", "without a checksum read")


IMPORTER = Importer("nmea", (".nmea", ".nma", ".ubx", ".log"), sniff, _Nmea.batches, rank=1)
