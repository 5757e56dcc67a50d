"""ROS 1 bags (plain, bz2, lz4) and ROS 2 bags (a ``.db3`` file, or a folder with ``metadata.yaml``).

The messages are those of :mod:`fleetlog.importers._messages`; the containers of ROS 2 are opened by ``rosbags``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleetlog.errors import FleetlogError, FormatError
from fleetlog.importers import mcap
from fleetlog.importers._bag_walk import MAGIC, BagFile
from fleetlog.importers._bounded import refuse_packed
from fleetlog.importers._open import plain_stem
from fleetlog.importers._topics import Decoder, Role, Topic, plan
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, ReadReport

_SQLITE = b"SQLite format 3\x00"


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins as a bag, is a SQLite file called ``.db3``, or a folder that holds a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(path.glob("*.db3"))
    empty = not head and path.suffix.lower() in (".bag", ".db3")
    return (
        empty or head.startswith(b"#ROSBAG V") or (head.startswith(_SQLITE) and path.suffix.lower() == ".db3")
    )


def read(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Positions and batteries, in the order of the bag."""
    if path.is_dir():
        yield from _folder(path, options)
        return
    refuse_packed(path)
    with path.open("rb") as stream:
        magic = stream.read(len(MAGIC))
    if not magic:
        raise FormatError("the file is empty", where=path, do="record it again")
    if magic == MAGIC:
        yield from _ros1(path, options)
    elif magic.startswith(b"#ROSBAG"):
        version = magic.split(b"\n")[0].decode("ascii", "replace")
        raise FormatError(
            f"bag of a format before 2.0 ({version})", where=path, do="convert it with rosbag migrate"
        )
    else:
        yield from _ros2(path, options)


def _ros1(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    with path.open("rb") as stream:
        bag = BagFile(path, stream, options.report)
        if not bag.indexed():
            options.report.damaged("the bag was not closed: it has no index")
            scan = BagFile(path, stream, ReadReport(path))
            for _ in scan.messages():
                pass
            bag.channels |= scan.channels
        topics = [Topic(*c) for c in bag.channels.values()]
        roles = plan(topics, path, plain_stem(path), options.vehicle, options.report)
        decoder = Decoder(roles, options.report, bag.share)
        for channel, time, data in bag.messages():
            yield from decoder.feed(channel.topic, time, data)
        yield from _end(path, options.report, roles, decoder)


def _end(path: Path, report: ReadReport, roles: dict[str, Role], decoder: Decoder) -> Iterator[RawBatch]:
    if not decoder.positions:
        raise mcap.nothing(path, report, roles)
    yield from decoder.drain()


def _folder(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    packed = [*path.glob("*.db3.zstd"), *path.glob("*.mcap.zstd")]
    if packed:
        raise FormatError(
            "the bag's files are packed as a whole", where=path, do=f"unpack them: zstd -d {packed[0].name}"
        )
    files = sorted(path.glob("*.mcap"))
    for file in files:
        yield from mcap.read(file, options, plain_stem(path))
    if not files:
        yield from _ros2(path, options)


def _ros2(path: Path, options: ReadOptions) -> Iterator[RawBatch]:
    """Through ``rosbags``; whatever it raises on a damaged file ends the reading, not the import."""
    from rosbags.rosbag2 import Reader

    roles: dict[str, Role] = {}
    decoder: Decoder | None = None
    try:
        with Reader(path) as bag:
            _check_packing(bag, path)
            topics = [Topic(c.topic, c.msgtype, _encoding(c)) for c in bag.connections]
            roles = plan(topics, path, plain_stem(path), options.vehicle, options.report)
            total = max(bag.message_count, 1)
            decoder = Decoder(roles, options.report, lambda: decoder.record / total if decoder else 0.0)
            wanted = [c for c in bag.connections if c.topic in roles]
            for connection, time, data in bag.messages(connections=wanted):
                yield from decoder.feed(connection.topic, (time + 500) // 1000, data)
    except FleetlogError:
        raise
    except Exception as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        if decoder is None or not decoder.positions:
            raise FormatError(
                f"cannot be read ({why})", where=path, do="repair it with ros2 bag reindex"
            ) from None
        options.report.damaged(f"breaks off after {decoder.record} messages ({why})")
    assert decoder is not None
    yield from _end(path, options.report, roles, decoder)


def _check_packing(bag: Any, path: Path) -> None:
    if bag.compression_mode:
        raise FormatError(
            "the bag's messages are packed one by one",
            where=path,
            do="convert it with ros2 bag convert to plain storage",
        )


def _encoding(connection: Any) -> str:
    return str(getattr(connection.ext, "serialization_format", "cdr"))


IMPORTER = Importer("rosbag", (".bag", ".db3"), sniff, read)
