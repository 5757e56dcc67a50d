"""The recording of what a user names: finding it, saying what it holds, starting the viewer on it."""

import atexit
import os
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
        with path.open("rb") as stream:
            if stream.read(4) != b"RRF2":
                do = "name a dataset, or import the log first (fleetlog import)"
                raise InputError("is not a Rerun recording", where=path, do=do)
        return path
    from fleetlog.view.recording import RATE, write_recording

    recording, description = path / "recording.rrd", path / "dataset.json"
    if is_url(path) or day is not None:
        folder = tempfile.mkdtemp(prefix="fleetlog-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        say(f"making the replay of {path}" + ("" if day is None else f" on {day}"))
        return write_recording(path, Path(folder) / "recording.rrd", rate_hz=rate_hz or RATE, day=day)
    there = recording.is_file()
    if not (there or description.is_file()):
        do = "name a dataset, an analysis or an .rrd file"
        raise InputError("holds no recording.rrd and is no dataset", where=path, do=do)
    made_of = description.stat().st_mtime - 1.0 if description.is_file() else None
    if made_of is not None and (not there or recording.stat().st_mtime < made_of or rate_hz is not None):
        say(f"making {recording}")
        write_recording(path, recording, rate_hz=rate_hz or RATE)
    return recording


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

    recordings: list[dict[str, Any]] = []
    try:
        # Rerun warns, and does not raise, where a file was not closed
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            reader = RrdReader(str(path))
            for store in reader.recordings():
                entities: Counter[str] = Counter()
                timelines: set[str] = set()
                for chunk in reader.stream(store=store):
                    entities[str(chunk.entity_path)] += int(chunk.num_rows)
                    timelines |= set(map(str, chunk.timeline_names))
                shown = {k: rows for k, rows in sorted(entities.items()) if not k.startswith("/__")}
                recordings.append({
                    "application": store.application_id, "recording": store.recording_id, "entities": shown,
                    "rows": sum(shown.values()), "timelines": sorted(timelines),
                })  # fmt: skip
            blueprints = len(reader.blueprints())
    except Exception as error:  # Rerun raises its own kinds and RuntimeError alike
        why = " ".join(str(error).split())[:160]
        raise InputError(f"not readable as a recording: {why}", where=path, do=AGAIN) from None
    if not any(r["rows"] for r in recordings):
        raise InputError("no recording with a row in it", where=path, do=AGAIN)
    open_end = any("no footer" in str(w.message) for w in heard)
    damage = ["the recording was not closed: it has no footer"] if open_end else []
    return {"recordings": recordings, "blueprint": blueprints > 0, "damage": damage}
