"""Binary recordings, walked in the order of the file: verify every record, resume behind damage, count.

No index is needed: a file that was cut off gives all that is whole.  An index at its end says where to go on
behind damage and how many messages there must be.
"""

import struct
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, NamedTuple

from fleetlog.core.words import count
from fleetlog.importers._messages import Topic
from fleetlog.importers._open import Damaged
from fleetlog.importers._report import ReadReport

DAMAGE_LINES = 10
FAULTS = (Damaged, struct.error, KeyError, ValueError)  # What broken bytes raise


Message = tuple[Topic, int, Any]  # Topic, time [us], data


class Record(NamedTuple):
    """A record: its kind, its header (or None), its content, and the place after it."""

    kind: int
    header: Any
    data: Any
    after: int


@dataclass
class Summary:
    """What the end of a whole file says about it."""

    channels: dict[int, Topic] = field(default_factory=dict)
    chunks: set[int] = field(default_factory=set)
    messages: int = 0


class Walk(ABC):
    """An open container; ``channels`` grows while :meth:`messages` goes on."""

    called: ClassVar[str]
    magic: ClassVar[bytes]
    kinds: ClassVar[frozenset[int]]
    """Records that the format has; ``chunk`` holds messages, behind ``ends`` come none."""
    chunk: ClassVar[int]
    ends: ClassVar[frozenset[int]] = frozenset()

    def __init__(self, path: Path, stream: BinaryIO, report: ReadReport) -> None:
        self.stream, self.report = stream, report
        self.size = path.stat().st_size
        self.at = 0
        self.channels: dict[int, Topic] = {}
        self.count = 0
        """Whole messages so far."""
        self.indexed = 0
        """Messages that the indices on the way speak of."""
        self._damages = 0

    @abstractmethod
    def summary(self) -> Summary | None:
        """Channels, chunks and number of messages from the index; None where it is damaged."""

    @abstractmethod
    def _next(self) -> Record:
        """The record at ``at``, checked as far as its length."""

    @abstractmethod
    def _take(self, record: Record) -> Iterator[Message]:
        """The messages in a record; other records are taken note of."""

    def _cut_off(self) -> bool:
        """Whether the end of the file is missing although every record is whole."""
        return False

    def share(self) -> float:
        """Share of the file that has been read."""
        return min(self.at / max(self.size, 1), 1.0)

    def messages(self, summary: Summary | None) -> Iterator[Message]:
        """Every whole message, in the order of the file; ``report`` hears of damage and gaps."""
        chunks = summary.chunks if summary else set()
        self.at = len(self.magic)
        while self.at < self.size:
            try:
                record = self._checked(self._next(), chunks)
            except FAULTS as error:
                self.say(f"{_why(error)} (byte {self.at:,})")
                onward = [c for c in chunks if c > self.at]
                if not onward:
                    break
                self.at = min(onward)
                continue
            if record.kind in self.ends:
                break
            try:
                yield from self._take(record)
            except FAULTS as error:
                what = "chunk" if record.kind == self.chunk else "record"
                self.say(f"the {what} at byte {self.at:,} is damaged ({_why(error)})")
            self.at = record.after
        self._close(max(summary.messages if summary else 0, self.indexed))

    def _checked(self, record: Record, chunks: set[int]) -> Record:
        """The record as the index has it: it knows where chunks are, and that more follows."""
        if self.at in chunks and record.kind != self.chunk:
            self.say(f"the kind of the chunk at byte {self.at:,} is wrong")
            return record._replace(kind=self.chunk)
        if record.kind in self.ends and any(c > self.at for c in chunks):
            raise Damaged("an end where chunks should follow")
        if record.kind not in self.kinds:
            self.say(f"a record of the unknown kind {record.kind} (byte {self.at:,})")
        return record

    def _close(self, expected: int) -> None:
        """Compare what was read with what there should be."""
        if not self._damages and self._cut_off():
            self.say("the end of the file is cut off")
        if self.count < expected:
            missing = expected - self.count
            verb = "is" if missing == 1 else "are"
            self.say(f"{count(missing, 'message')} that the file counts {verb} not in it")
        if self._damages:
            share = f"of {expected:,}" if 0 < expected >= self.count else "outside of the damage"
            self.report.damaged(f"{count(self.count, 'message')} {share} are whole")

    def say(self, text: str) -> None:
        """Report damage; of very much the first."""
        self._damages += 1
        if self._damages <= DAMAGE_LINES:
            self.report.damaged(text)
        elif self._damages == DAMAGE_LINES + 1:
            self.report.damaged("more damage of this kind")


def _why(error: Exception) -> str:
    return str(error) if isinstance(error, Damaged) else f"it lacks a field: {type(error).__name__}"
