"""MCAP recordings: Foxglove's LocationFix, ROS 2's positions and batteries; see :mod:`fleetlog.importers._messages`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fleetlog.errors import FormatError
from fleetlog.importers._bounded import refuse_packed
from fleetlog.importers._mcap_walk import MAGIC, Channel, McapFile, Summary
from fleetlog.importers._open import plain_stem
from fleetlog.importers._topics import Decoder, Role, Topic, plan
from fleetlog.importers.base import Importer, RawBatch, ReadOptions, ReadReport


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins with MCAP's magic bytes."""
    return head.startswith(MAGIC)


def read(path: Path, options: ReadOptions, name: str | None = None) -> Iterator[RawBatch]:
    """Positions and batteries, in the order of the file; ``name`` is the vehicle's where the topics name none."""
    refuse_packed(path)
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise FormatError(
                "is not an MCAP file (its first bytes are wrong)", where=path, do="check the format"
            )
        file = McapFile(path, stream, options.report)
        summary = file.summary()
        roles = _roles(path, summary, options, name or plain_stem(path))
        decoder = Decoder(roles, options.report, file.share)
        for channel, time, data in file.messages(summary):
            yield from decoder.feed(channel.topic, time, data)
        if not decoder.positions:
            raise nothing(path, options.report, roles)
        yield from decoder.drain()


def _roles(path: Path, summary: Summary | None, options: ReadOptions, name: str) -> dict[str, Role]:
    """The plan for the topics; without a summary the file is walked once for them."""
    channels = summary.channels if summary else _scan(path)
    return plan([Topic(*c) for c in channels.values()], path, name, options.vehicle, options.report)


def _scan(path: Path) -> dict[int, Channel]:
    with path.open("rb") as stream:
        file = McapFile(path, stream, ReadReport(path))
        for _ in file.messages(None):
            pass
        return file.channels


def nothing(path: Path, report: ReadReport, roles: dict[str, Role]) -> FormatError:
    """The error for a recording without one usable position."""
    topics = ", ".join(name for name, role in roles.items() if role.is_position)
    damage = f"; {report.damage[0]}" if report.damage else ""
    return FormatError(f"not one usable position on {topics}{damage}", where=path, do="record it again")


IMPORTER = Importer("mcap", (".mcap",), sniff, read)
