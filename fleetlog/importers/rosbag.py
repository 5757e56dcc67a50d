"""ROS 1 bags (plain, bz2, lz4) and ROS 2 bags (a ``.db3`` file, or a folder with ``metadata.yaml``).

Readers that go by the index of ROS 1 refuse a bag cut off; here it is walked.  wiki.ros.org/Bags/Format/2.0

The messages are those of :mod:`fleetlog.importers._messages`; ``rosbags`` opens the containers of ROS 2."""

import re
import struct
from collections.abc import Iterator
from pathlib import Path

from fleetlog.core.files import SETTINGS, open_regular, read_whole
from fleetlog.errors import FleetlogError, FormatError
from fleetlog.importers._messages import Topic
from fleetlog.importers._open import LIMIT, Damaged, cut, plain_stem, plain_suffix, refuse_packed, unpack
from fleetlog.importers._topics import Decoder, plan, read_recording
from fleetlog.importers._walk import Item, Message, Record, Walk
from fleetlog.importers.base import Importer, RawBatch, ReadOptions
from fleetlog.importers.mcap import McapWalk

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_LENGTH = struct.Struct("<I")
Header = dict[bytes, bytes]
_SQLITE = b"SQLite format 3\x00"
_PACKING = re.compile(r"^\s*compression_mode:\s*[\"']?(file|message)", re.MULTILINE | re.IGNORECASE)
_COUNT = re.compile(r"^\s*message_count:\s*(\d{1,18})\s*$", re.MULTILINE)  # The first is the whole bag's


class BagWalk(Walk):
    """An open bag; ``channels`` are its connections."""

    called = "a ROS 1 bag"
    magic = MAGIC
    chunk, inner = CHUNK, frozenset({CONNECTION, MESSAGE})
    kinds = frozenset({MESSAGE, HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION})

    def _index(self) -> bool:
        """From the connections and chunk infos at the end of the bag."""
        self.at = len(MAGIC)
        first = self._next()
        (self.at,) = struct.unpack("<Q", first.header[b"index_pos"])
        stated = tuple(_LENGTH.unpack(first.header[k])[0] for k in (b"conn_count", b"chunk_count"))
        if first.kind != HEADER or not 0 < self.at <= self.size:
            return False
        while self.at < self.size:
            kind, header, data, self.at = self._next()
            if kind not in (CONNECTION, CHUNK_INFO):
                return False
            self._take(kind, header, data)
        self.stated = sum(self.chunks.values())
        return (len(self.channels), len(self.chunks)) == stated

    def _next(self) -> Record:
        self.stream.seek(self.at)
        header = _header(self._block())
        return Record(int.from_bytes(header[b"op"], "little"), header, self._block(), self.stream.tell())

    def _block(self) -> bytes:
        head = self.stream.read(4)
        if len(head) < 4:
            raise Damaged("the bag breaks off")
        (length,) = _LENGTH.unpack(head)
        if length > min(self.size - self.stream.tell(), LIMIT):
            raise Damaged("a record runs beyond the end of the bag: it is cut off or damaged")
        return self.stream.read(length)

    def _items(self, chunk: Record) -> Iterator[Item]:
        (size,) = _LENGTH.unpack(chunk.header[b"size"])
        data = unpack(chunk.header[b"compression"].decode("ascii", "replace"), chunk.data, size)
        at = 0
        while at < len(data):
            head, at = cut(data, at, _LENGTH)
            body, at = cut(data, at, _LENGTH)
            header = _header(head)
            yield int.from_bytes(header[b"op"], "little"), header, body

    def _take(self, kind: int, header: Header, data: bytes) -> Message | None:
        if kind == MESSAGE:
            seconds, nanoseconds = struct.unpack("<II", header[b"time"])
            return _LENGTH.unpack(header[b"conn"])[0], seconds * 1_000_000 + (nanoseconds + 500) // 1000, data
        if kind == CONNECTION:
            about = _header(data)
            topic = about.get(b"topic") or header[b"topic"]
            schema = about.get(b"type", b"").decode("utf-8", "replace")
            channel = Topic(topic.decode("utf-8", "replace"), schema, "ros1")
            self.channels[_LENGTH.unpack(header[b"conn"])[0]] = channel
        elif kind == INDEX:
            self.indexed += _LENGTH.unpack(header[b"count"])[0]
        elif kind == CHUNK_INFO:
            messages = sum(count for _, count in struct.iter_unpack("<II", data))
            self.chunks[struct.unpack("<Q", header[b"chunk_pos"])[0]] = messages
        return None


def _header(data: bytes) -> Header:
    """The fields ``name=value`` of a header."""
    fields, at = {}, 0
    while at < len(data):
        field, at = cut(data, at, _LENGTH)
        name, _, value = field.partition(b"=")
        fields[name] = value
    return fields


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins as a bag, is a SQLite file called ``.db3``, or a folder that holds a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    suffix = plain_suffix(path)
    empty = not head and suffix in (".bag", ".db3")
    return empty or head.startswith(b"#ROSBAG V") or (head.startswith(_SQLITE) and suffix == ".db3")


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Positions and batteries, in the order of the bag."""
    if path.is_dir():
        yield from _folder(path, options)
        return
    with open_regular(path) as stream:
        magic = stream.read(len(MAGIC))
    if not magic:
        raise FormatError("the file is empty", where=path, do="record it again")
    if magic == MAGIC:
        yield from read_recording(BagWalk, path, options)
    elif magic.startswith(b"#ROSBAG"):
        version = magic.split(b"\n")[0].decode("ascii", "replace")
        raise FormatError(f"bag of a format before 2.0 ({version})", where=path, do="use rosbag migrate")
    else:
        yield from _ros2(path, options)


def _folder(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    if packed := [*path.glob("*.db3.zstd"), *path.glob("*.mcap.zstd")]:
        do = f"unpack them: zstd -d {packed[0].name}"
        raise FormatError("the bag's files are packed as a whole", where=path, do=do)
    description = path / "metadata.yaml"
    about = read_whole(description, SETTINGS).decode("utf-8", "replace") if description.exists() else ""
    others = sum(p.suffix not in (".mcap", ".db3", ".yaml") for p in path.iterdir())
    options.report.tally(others, "other file", "in the bag's folder left out")
    if mode := _PACKING.search(about):
        what = f"the bag is packed {mode[1].lower()} by {mode[1].lower()}"
        raise FormatError(what, where=path, do="convert it with ros2 bag convert to plain storage")
    if not (files := sorted(path.glob("*.mcap"))):
        yield from _ros2(path, options)
        return
    whole, errors = 0, []
    for file in files:
        try:
            whole += yield from read_recording(McapWalk, file, options, plain_stem(path))
        except FleetlogError as error:
            errors.append(error)
            options.report.damaged(f"{file.name}: {error.what}")
    if len(errors) == len(files):
        raise errors[0]
    if (stated := _COUNT.search(about)) and whole < int(stated[1]):
        options.report.damaged(f"{whole:,} of the {int(stated[1]):,} messages by metadata.yaml are whole")


def _ros2(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Through ``rosbags``; whatever it raises on a damaged file ends the reading, not the import."""
    from rosbags.rosbag2 import Reader

    decoder: Decoder | None = None
    for file in sorted(path.glob("*.db3")) if path.is_dir() else [path]:
        refuse_packed(file)
    try:
        with Reader(path) as bag:
            encoded = ((c, getattr(c.ext, "serialization_format", "cdr")) for c in bag.connections)
            topics = [Topic(c.topic, c.msgtype, str(encoding)) for c, encoding in encoded]
            roles = plan(topics, path, plain_stem(path), options.vehicle, options.report)
            total = max(bag.message_count, 1)
            decoder = Decoder(roles, options.report, lambda: decoder.record / total if decoder else 0.0)
            wanted = [c for c in bag.connections if c.topic in roles]
            messages = bag.messages(connections=wanted)
            yield from decoder.batches((c.topic, (time + 500) // 1000, data) for c, time, data in messages)
        if decoder.record < (stated := sum(c.msgcount for c in wanted)):
            options.report.damaged(f"{decoder.record:,} of the {stated:,} messages that it counts are in it")
    except FleetlogError:
        raise
    except Exception as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        if decoder is None or not decoder.positions:
            raise FormatError(f"cannot be read ({why})", where=path, do="try ros2 bag reindex") from None
        options.report.damaged(f"breaks off after {decoder.record} messages ({why})")
    assert decoder is not None
    yield from decoder.finish()


IMPORTER = Importer("rosbag", (".bag", ".db3"), sniff, read)
