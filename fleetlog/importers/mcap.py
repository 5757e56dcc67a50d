"""MCAP recordings of Foxglove's and ROS 2's positions and batteries."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

from fleetlog.importers._mcap_walk import MAGIC, McapWalk
from fleetlog.importers._topics import read_recording
from fleetlog.importers.base import Importer, RawBatch, ReadOptions


def sniff(path: Path, head: bytes) -> bool:
    """Whether it begins with MCAP's magic bytes."""
    return head.startswith(MAGIC)


def read(path: Path, options: ReadOptions) -> Generator[RawBatch, None, int]:
    """Positions and batteries, in the order of the file."""
    return (yield from read_recording(McapWalk, path, options))


IMPORTER = Importer("mcap", (".mcap",), sniff, read)
