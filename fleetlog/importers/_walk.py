"""Binary recordings, walked in the order of the file: verify every record, resume behind damage, count.

No index is needed: a file that was cut off gives all that is whole.  An index at its end says where to go on
behind damage and how many messages there must be."""

import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, NamedTuple

from fleetlog.core.words import count
from fleetlog.importers._messages import Topic
from fleetlog.importers._open import Damaged, ReadReport

DAMAGE_LINES = 10
FAULTS = (Damaged, struct.error, KeyError, ValueError)  # What broken bytes raise
Item = tuple[int, Any, Any]  # Kind, header (or None) and content of a record
Message = tuple[int, int, Any]  # Number of the channel, time [us], data


class Record(NamedTuple):
    """A record: its kind, its header (or None), its content, and the place after it."""

    kind: int
    header: Any
    data: Any
    after: int


class Walk(ABC):
    """An open container; :meth:`index` comes first, what it says of the file grows with :meth:`messages`."""

    called: ClassVar[str]
    magic: ClassVar[bytes]
    kinds: ClassVar[frozenset[int]]
    """Records that the format has; ``chunk`` holds those of ``inner``, behind ``ends`` comes no message."""
    chunk: ClassVar[int]
    inner: ClassVar[frozenset[int]]
    ends: ClassVar[frozenset[int]] = frozenset()
    tail: ClassVar[bytes] = b""  # As long as ``magic``: what a whole file ends with that has no index

    def __init__(self, path: Path, stream: BinaryIO, report: ReadReport) -> None:
        self.stream, self.report = stream, report
        self.size = path.stat().st_size
        self.at = self.count = 0  # Place in the file, and whole messages so far
        self.schemas: dict[int, str] = {}  # Their names, where channels tell them by number
        self.channels: dict[int, Topic] = {}
        self.chunks: dict[int, int] = {}  # Messages in the chunk at each place, where the index tells them
        self.stated = self.indexed = 0  # Messages of which the index at the end, and those on the way, speak
        self.whole = False
        self._damages = 0

    @abstractmethod
    def _index(self) -> bool:
        """Take note of what the end of the file says; False where it says nothing."""

    @abstractmethod
    def _next(self) -> Record:
        """The record at ``at``, checked as far as its length."""

    @abstractmethod
    def _items(self, chunk: Record) -> Iterable[Item]:
        """The records in a chunk."""

    @abstractmethod
    def _take(self, kind: int, header: Any, data: Any) -> Message | None:
        """The message that a record is; other records are taken note of."""

    def share(self) -> float:
        """Share of the file that has been read."""
        return min(self.at / max(self.size, 1), 1.0)

    def index(self) -> bool:
        """Whether the index at the end of the file is whole; then channels, chunks and counts are known."""
        with suppress(*FAULTS):
            self.whole = self._index()
        if not self.whole:
            self.channels, self.chunks, self.stated = {}, {}, 0
        return self.whole

    def messages(self) -> Iterator[tuple[str, int, Any]]:
        """Every whole message: topic, time [us], data; ``report`` hears of damage and gaps."""
        self.at = len(self.magic)
        while self.at < self.size:
            try:
                record = self._checked(self._next())
            except FAULTS as error:
                self.say(f"{_why(error)} (byte {self.at:,})")
                self.at = min((c for c in self.chunks if c > self.at), default=self.size)
                continue
            if record.kind in self.ends:
                break
            is_chunk = record.kind == self.chunk
            known = self.inner if is_chunk else self.kinds
            try:
                for item in self._items(record) if is_chunk else [record[:3]]:
                    message = self._take(*item) if item[0] in known else None
                    if message is None:
                        continue
                    number, time, data = message
                    if (channel := self.channels.get(number)) is None:
                        self.say(f"a message of the unknown channel {number}")
                        continue
                    self.count += 1
                    yield channel.name, time, data
            except FAULTS as error:
                what = "chunk" if is_chunk else "record"
                self.say(f"the {what} at byte {self.at:,} is damaged ({_why(error)})")
            self.at = record.after
        self._close(max(self.stated, self.indexed))

    def _checked(self, record: Record) -> Record:
        """The record as the index has it: it knows where chunks are, and that more follows."""
        if self.at in self.chunks and record.kind != self.chunk:
            self.say(f"the kind of the chunk at byte {self.at:,} is wrong")
            return record._replace(kind=self.chunk)
        if record.kind in self.ends and any(c > self.at for c in self.chunks):
            raise Damaged("an end where chunks should follow")
        if record.kind not in self.kinds:
            self.say(f"a record of the unknown kind {record.kind} (byte {self.at:,})")
        return record

    def _close(self, expected: int) -> None:
        """Compare what was read with what there should be."""
        self.stream.seek(max(self.size - len(self.magic), 0))
        if not self._damages and not self.whole and self.stream.read() != self.tail:
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
        self.report.damaged(text if self._damages <= DAMAGE_LINES else "more damage of this kind")


def _why(error: Exception) -> str:
    return str(error) if isinstance(error, Damaged) else f"it lacks a field: {type(error).__name__}"
