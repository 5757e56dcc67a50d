"""ROS 1 bags (plain, bz2, lz4) and ROS 2 bags (a ``.db3`` file, or a folder with ``metadata.yaml``).

The messages are those of :mod:`fleetlog.importers._messages`; ``rosbags`` opens the containers of ROS 2.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from fleetlog.core.files import SETTINGS, open_regular, read_whole
from fleetlog.core.words import count
from fleetlog.errors import FleetlogError, FormatError
from fleetlog.importers._bag_walk import MAGIC, BagWalk
from fleetlog.importers._messages import Topic
from fleetlog.importers._open import plain_stem, plain_suffix, refuse_packed
from fleetlog.importers._topics import Decoder, plan, read_recording
from fleetlog.importers.base import Importer, RawBatch, ReadOptions
from fleetlog.importers.mcap import McapWalk

_SQLITE = b"SQLite format 3\x00"
_PACKING = re.compile(r"^\s*compression_mode:\s*[\"']?(file|message)", re.MULTILINE | re.IGNORECASE)
_COUNT = re.compile(r"^\s*message_count:\s*(\d{1,18})\s*$", re.MULTILINE)
"""The first one is that of the whole bag."""


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
        what = f"bag of a format before 2.0 ({version})"
        raise FormatError(what, where=path, do="convert it with rosbag migrate")
    else:
        yield from _ros2(path, options)


def _folder(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    packed = [*path.glob("*.db3.zstd"), *path.glob("*.mcap.zstd")]
    if packed:
        do = f"unpack them: zstd -d {packed[0].name}"
        raise FormatError("the bag's files are packed as a whole", where=path, do=do)
    description = path / "metadata.yaml"
    about = read_whole(description, SETTINGS).decode("utf-8", "replace") if description.exists() else ""
    others = sum(p.suffix not in (".mcap", ".db3", ".yaml") for p in path.iterdir())
    if others:
        options.report.note(f"{count(others, 'other file')} in the bag's folder left out")
    if mode := _PACKING.search(about):
        what = f"the bag is packed {mode[1].lower()} by {mode[1].lower()}"
        raise FormatError(what, where=path, do="convert it with ros2 bag convert to plain storage")
    files = sorted(path.glob("*.mcap"))
    if not files:
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
        what = f"{whole:,} of the {int(stated[1]):,} messages that metadata.yaml counts are whole"
        options.report.damaged(what)


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
            for connection, time, data in bag.messages(connections=wanted):
                yield from decoder.feed(connection.topic, (time + 500) // 1000, data)
        if decoder.record < (stated := sum(c.msgcount for c in wanted)):
            what = f"{decoder.record:,} of the {stated:,} messages"
            options.report.damaged(f"{what} that the bag counts are in it")
    except FleetlogError:
        raise
    except Exception as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        if decoder is None or not decoder.positions:
            do = "repair it with ros2 bag reindex"
            raise FormatError(f"cannot be read ({why})", where=path, do=do) from None
        options.report.damaged(f"breaks off after {decoder.record} messages ({why})")
    assert decoder is not None
    yield from decoder.finish()


IMPORTER = Importer("rosbag", (".bag", ".db3"), sniff, read)
