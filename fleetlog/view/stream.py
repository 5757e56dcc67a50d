"""A recording being written: the one place that opens a Rerun stream and sends columns in chunks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from fleetlog.core.trajectory import Ints
from fleetlog.errors import OutputError

APPLICATION, TIMELINE = "fleetlog", "utc"
CHUNK = 32_768
"""Rows a chunk: 8 to 65 thousand open fast and keep the viewer's memory low."""


def nanoseconds(time: Ints) -> Any:
    """Microseconds since 1970 (UTC) as datetime64[ns]."""
    return np.asarray(time, dtype="datetime64[us]").astype("datetime64[ns]")


def entity(*names: str) -> str:
    """An entity path; names are escaped where a log's own ids need it."""
    return str(rr.new_entity_path([n for n in names if n]))


class Stream:
    """Thin writer over a recording stream."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self.recording = recording

    def static(self, path: str, *archetypes: Any) -> None:
        """Data without a time."""
        for archetype in archetypes:
            self.recording.log(path, archetype, static=True)

    def columns(self, path: str, time: Ints, columns: Callable[[slice], Any]) -> None:
        """``columns(rows)`` gives the component columns of a slice of the rows at ``time``."""
        for begin in range(0, len(time), CHUNK):
            rows = slice(begin, min(begin + CHUNK, len(time)))
            index = rr.TimeColumn(TIMELINE, timestamp=nanoseconds(time[rows]))
            self.recording.send_columns(path, [index], columns(rows))

    def parts(self, path: str, time: Ints, lengths: Ints, columns: Callable[[slice], Any]) -> None:
        """Like :meth:`columns` for rows of ``lengths`` instances; ``columns`` gets the slice of the instances."""
        ends = np.concatenate([[0], np.cumsum(lengths)])
        for begin in range(0, len(time), CHUNK):
            stop = min(begin + CHUNK, len(time))
            data = columns(slice(int(ends[begin]), int(ends[stop])))
            index = rr.TimeColumn(TIMELINE, timestamp=nanoseconds(time[begin:stop]))
            self.recording.send_columns(path, [index], data.partition(lengths[begin:stop]))


@contextmanager
def open_stream(path: Path, name: str, start: Ints | int | None = None) -> Iterator[Stream]:
    """A stream that writes the .rrd file ``path``; errors of the data raise, nothing is dropped in silence."""
    rr.set_strict_mode(True)
    # No recording id of our own: the viewer would take two files of one id, such as two imports, for one recording.
    try:
        with rr.RecordingStream(APPLICATION, send_properties=True) as recording:
            rr.set_log_time_enabled(False, recording=recording)
            if not rr.is_enabled(recording=recording):
                raise OutputError("Rerun is switched off (RERUN=off)", where=path, do="unset RERUN")
            recording.save(str(path))
            recording.send_recording_name(name)
            if start is not None:
                recording.send_recording_start_time_nanos(int(start) * 1000)
            recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            yield Stream(recording)
    except RuntimeError as error:
        raise OutputError(
            f"recording not written: {error}", where=path, do="check space and permissions"
        ) from None
