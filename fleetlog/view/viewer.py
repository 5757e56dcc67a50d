"""The recording of what a user names: finding it, saying what it holds, starting the viewer on it."""

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.errors import InputError
from fleetlog.store.places import is_url
from fleetlog.view.headless import ViewerError, binary, environment, free_port

AGAIN = "make it again from its dataset"


def recording_of(
    path: Path, *, rate_hz: float | None = None, day: str | None = None, say: Callable[[str], None] = print
) -> Path:
    """The .rrd file of a recording, an analysis or a dataset; made, or made again, for that where needed.

    That of one ``day`` of a dataset, or of one elsewhere, is in a folder that goes when this process ends.
    """
    if path.is_file():
        return _checked(path)
    recording = path / "recording.rrd"
    description = path / "dataset.json"
    if is_url(path) or day is not None:
        folder = tempfile.mkdtemp(prefix="fleetlog-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        say(f"making the replay of {path}" + ("" if day is None else f" on {day}"))
        return _made(path, Path(folder) / "recording.rrd", rate_hz, day)
    if not description.is_file():
        if recording.is_file():
            return recording
        do = "name a dataset, an analysis or an .rrd file"
        raise InputError("holds no recording.rrd and is no dataset", where=path, do=do)
    old = not recording.is_file() or recording.stat().st_mtime < description.stat().st_mtime - 1.0
    if old or rate_hz is not None:
        say(f"making {recording}")
        _made(path, recording, rate_hz)
    return recording


def _made(dataset: Path, out: Path, rate_hz: float | None, day: str | None = None) -> Path:
    from fleetlog.view.recording import RATE, write_recording

    return write_recording(dataset, out, rate_hz=rate_hz or RATE, day=day)


def _checked(path: Path) -> Path:
    with path.open("rb") as stream:
        if stream.read(4) != b"RRF2":
            do = "name a dataset, or import the log first (fleetlog import)"
            raise InputError("is not a Rerun recording", where=path, do=do)
    return path


def middle_of_driving(path: Path, day: str | None = None) -> int | None:
    """Time [ns] in the middle of the middle trip of a dataset; None of anything without trips."""
    if not (path / "dataset.json").is_file():
        return None
    from fleetlog.store import Dataset

    trips = Dataset(path).trips.sort_values("start")
    if day is not None:
        trips = trips[trips["start"].dt.strftime("%Y-%m-%d") == day]
    if not len(trips):
        return None
    trip = trips.iloc[len(trips) // 2]
    return int((trip["start"] + (trip["end"] - trip["start"]) / 2).value)


def nanoseconds_of(iso: str) -> int:
    """Nanoseconds since 1970 of a time in ISO 8601, UTC unless it says otherwise."""
    from datetime import UTC, datetime

    try:
        moment = datetime.fromisoformat(iso)
    except ValueError:
        raise InputError(f"--at {iso!r} is no time", do="write it like 2026-03-02T06:01:00") from None
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return int(np.datetime64(moment.replace(tzinfo=None), "ns").astype(np.int64))


def has_screen() -> bool:
    """Whether a window can be opened here."""
    return sys.platform in ("win32", "darwin") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def show(rrd: Path) -> None:
    """Open the viewer on a recording and wait until it is closed; it listens on this machine only."""
    if not has_screen():
        do = "run fleetlog view on a machine with one, or draw it here with --screenshot FILE.png"
        raise ViewerError("there is no screen here", where=rrd, do=do)
    command = [str(binary()), "--bind", "127.0.0.1", "--port", str(free_port()), str(rrd)]
    status = subprocess.call(command, env=environment())
    if status:
        do = "see that its graphics driver works (vulkaninfo)"
        raise ViewerError(f"the viewer ended with status {status}", where=rrd, do=do)


def describe_recording(path: Path) -> dict[str, Any]:
    """Recordings, entities, rows, timelines and blueprints of a file; InputError where it is unreadable."""
    from rerun.chunk import RrdReader

    try:
        # Rerun warns, and does not raise, where a file was not closed
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            reader = RrdReader(str(path))
            recordings = [
                {"application": s.application_id, "recording": s.recording_id, **_contents(reader, s)}
                for s in reader.recordings()
            ]
            blueprints = len(reader.blueprints())
    except Exception as error:  # Rerun raises its own kinds and RuntimeError alike
        why = " ".join(str(error).split())[:160]
        raise InputError(f"not readable as a recording: {why}", where=path, do=AGAIN) from None
    if not any(r["rows"] for r in recordings):
        raise InputError("no recording with a row in it", where=path, do=AGAIN)
    open_end = any("no footer" in str(w.message) for w in heard)
    damage = ["the recording was not closed: it has no footer"] if open_end else []
    return {"recordings": recordings, "blueprint": blueprints > 0, "damage": damage}


def _contents(reader: Any, store: Any) -> dict[str, Any]:
    entities: dict[str, int] = {}
    timelines: set[str] = set()
    for chunk in reader.stream(store=store):
        path = str(chunk.entity_path)
        entities[path] = entities.get(path, 0) + int(chunk.num_rows)
        timelines |= {str(name) for name in chunk.timeline_names}
    shown = {k: v for k, v in sorted(entities.items()) if not k.startswith("/__")}
    return {"entities": shown, "rows": sum(shown.values()), "timelines": sorted(timelines)}
