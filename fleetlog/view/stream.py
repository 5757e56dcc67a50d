"""A recording being written: the one place that opens a Rerun stream and sends columns in chunks."""

import copyreg
import os
import re
import shutil
import struct
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from fleetlog.core.arrays import Array, Ints
from fleetlog.errors import OutputError
from fleetlog.store.output import remade
from fleetlog.view.clock import SKIPPED, Clock

APPLICATION, TIMELINE = "fleetlog", "utc"
Singles = Array  # float32: what the viewer keeps of a position anyway
_FOOTER = struct.Struct("<QQI8sI")
CHUNK = 32_768  # Rows a chunk: 8 to 65 thousand open fast and keep the viewer's memory low
ui_points = rr.Radius.ui_points  # A radius in points of the screen


def entity(*names: str) -> str:
    """An entity path; names are escaped where a log's own ids need it."""
    return str(rr.new_entity_path([n for n in names if n]))


def verbatim(text: str) -> str:
    """``text`` on one line of Markdown, nothing in it read as markup: a name is no link and no picture."""
    return re.sub(r"([\\`*_\[\]<>!#|~&])", r"\\\1", " ".join(text.split()))


class Tape(list[tuple[str, tuple[Any, ...], dict[str, Any]]]):
    """Stands in for a recording stream in another process: what was sent into it, to be sent on here."""

    def log(self, *args: Any, **more: Any) -> None:
        """As of a recording stream."""
        self.append(("log", args, more))

    def send_columns(self, *args: Any) -> None:
        """As of a recording stream."""
        self.append(("send_columns", args, {}))


copyreg.pickle(  # Rerun does not say how it is handed to another process
    rr.ComponentDescriptor, lambda d: (rr.ComponentDescriptor, (d.component, d.archetype, d.component_type))
)


class Stream:
    """Thin writer over a recording stream."""

    def __init__(self, recording: Any, clock: Clock | None = None) -> None:
        self.recording, self.clock = recording, clock

    def static(self, path: str, archetype: Any) -> None:
        """Data without a time."""
        self.recording.log(path, archetype, static=True)

    def rows(self, path: str, time: Ints, kind: Any, lengths: Ints | None = None, **fields: Any) -> None:
        """One instance of the archetype ``kind`` at each ``time``, or ``lengths`` (T,); ``fields`` of all."""
        if "strips" in fields:
            fields["strips"] = as_strips(fields["strips"])
        ends = np.append(0, np.cumsum(np.ones(len(time), np.int64) if lengths is None else lengths))
        for begin in range(0, len(time), CHUNK):
            rows = slice(begin, min(begin + CHUNK, len(time)))
            part = slice(int(ends[rows.start]), int(ends[rows.stop]))
            data = kind.columns(**{k: v[part] for k, v in fields.items()})
            index = [rr.TimeColumn(TIMELINE, timestamp=time[rows].astype("datetime64[us]"))]
            if self.clock is not None:
                passed = self.clock(time[rows]).astype("timedelta64[us]")
                index.append(rr.TimeColumn(SKIPPED, duration=passed))
            whole = data if lengths is None else data.partition(lengths[rows])
            self.recording.send_columns(path, index, whole)


def as_strips(strips: Sequence[Singles] | pa.Array, lengths: Ints | None = None) -> pa.Array:
    """Strips (n, 3), or all points (N, 3) and ``lengths``, as Rerun keeps them: its own way is far slower."""
    if isinstance(strips, pa.Array):
        return strips
    if lengths is None:
        lengths = np.array([len(s) for s in strips], np.int64)
        strips = np.concatenate([np.zeros((0, 3)), *strips], dtype=np.float32)
    points, ends = np.asarray(strips, np.float32), np.append(0, np.cumsum(lengths, dtype=np.int32))
    kind = rr.components.LineStrip3DBatch([]).as_arrow_array().type
    triples = pa.FixedSizeListArray.from_arrays(pa.array(points.ravel()), type=kind.value_type)
    return pa.ListArray.from_arrays(pa.array(ends, pa.int32()), triples, type=kind)


@contextmanager
def open_stream(path: Path, name: str, start: Ints | int | None = None) -> Iterator[Stream]:
    """A stream into the .rrd file ``path``, which appears whole, replacing an older one; errors raise."""
    rr.set_strict_mode(True)
    # No recording id of our own: the viewer would take two files of one id for one recording.
    recording = rr.RecordingStream(APPLICATION, send_properties=True)
    rr.set_log_time_enabled(False, recording=recording)
    if not rr.is_enabled(recording=recording):
        raise OutputError("Rerun is switched off (RERUN=off)", where=path, do="unset RERUN")
    with remade(path) as scratch:
        try:
            with _pipe_into(scratch) as pipe:
                recording.save(pipe)
                try:
                    recording.send_recording_name(name)
                    if start is not None:
                        recording.send_recording_start_time_nanos(int(start) * 1000)
                    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
                    yield Stream(recording)
                finally:
                    recording.disconnect()
        except RuntimeError as error:
            raise _unwritten(path, str(error)) from None
        check_whole(scratch)


@contextmanager
def _pipe_into(path: Path) -> Iterator[str]:
    """The name of a pipe into the file ``path``. Rerun's own writer of files ends at the first error of the
    disk, unheard, and who waits for it may wait forever; a pipe takes all, and the error is raised here."""
    receive, send = os.pipe()

    def copy() -> None:
        with os.fdopen(receive, "rb", buffering=0) as source:
            try:
                with path.open("wb") as sink:
                    shutil.copyfileobj(source, sink)
            finally:
                while source.read(1 << 16):
                    pass

    with ThreadPoolExecutor(1) as pool:
        copied = pool.submit(copy)
        try:
            yield f"/dev/fd/{send}"
        finally:
            os.close(send)
    if isinstance(error := copied.exception(), OSError):
        raise _unwritten(path, error.strerror or str(error))


def _unwritten(path: Path, why: str) -> OutputError:
    return OutputError(f"recording not written: {why}", where=path, do="check space and permissions")


def check_whole(path: Path) -> None:
    """Raise :class:`OutputError` unless an .rrd file ends as a closed one does, at the length that it states.
    Its last bytes: per manifest start, length (64 bits each), checksum; ``RRF2FOOT``, number of manifests."""
    with path.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(size - _FOOTER.size, 0))
        end = stream.read()
    if len(end) == _FOOTER.size:
        start, length, _, magic, count = _FOOTER.unpack(end)
        if magic == b"RRF2FOOT" and start + length == size - 12 - 20 * count:
            return
    raise _unwritten(path, "its end is missing")
