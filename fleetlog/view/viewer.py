"""The recording of what a user names: finding it, saying what it holds, showing it.

Without a screen the real viewer opens it and paints by the processor (Mesa lavapipe).  All that fleetlog
uses of ``rerun.experimental`` is here, because it may change with every release."""

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog import scratch
from fleetlog.core.files import is_url
from fleetlog.errors import FleetlogError, InputError
from fleetlog.view.stream import TIMELINE

AGAIN = "make it again from its dataset"
WAIT = 60.0  # Longest wait for the viewer [s]


def recording_of(
    path: Path, *, rate_hz: float | None = None, day: str | None = None, say: Callable[[str], None] = print
) -> Path:
    """The .rrd file of a recording, an analysis or a dataset; made, or made again, where needed.  That of
    one ``day`` of a dataset, or of one elsewhere, is in a folder that goes when this process ends."""
    if path.is_file():
        with path.open("rb") as stream:
            if stream.read(4) != b"RRF2":
                do = "name a dataset, or import the log first (fleetlog import)"
                raise InputError("is not a Rerun recording", where=path, do=do)
        return path
    from fleetlog.view.recording import RATE, write_recording

    recording, description = path / "recording.rrd", path / "dataset.json"
    if is_url(path) or day is not None:
        say(f"making the replay of {path}" + ("" if day is None else f" on {day}"))
        return write_recording(path, scratch.folder() / "recording.rrd", rate_hz=rate_hz or RATE, day=day)
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
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return sys.platform in ("win32", "darwin") or bool(named)


def show(rrd: Path) -> None:
    """Open the viewer on a recording and wait until it is closed; it listens on this machine only."""
    if not has_screen():
        do = "run fleetlog view on a machine with one, or draw it here with --screenshot FILE.png"
        raise ViewerError("there is no screen here", do=do)
    command = [str(binary()), "--bind", "127.0.0.1", "--port", str(free_port()), str(rrd)]
    if status := subprocess.call(command, env=environment()):
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


class ViewerError(FleetlogError):
    """The viewer cannot be started or does not answer."""


def binary() -> Path:
    """The native viewer; ``rerun`` on the path is a script whose end leaves it running."""
    import rerun_cli  # type: ignore[import-untyped]  # the package carries no types

    return Path(rerun_cli.__file__).with_name("rerun.exe" if os.name == "nt" else "rerun")


def vulkan_missing() -> str | None:
    """Why the viewer cannot draw without a screen here; None where it can."""
    import ctypes.util

    if ctypes.util.find_library("vulkan") is None:
        return "no Vulkan library: install the packages libvulkan1 and mesa-vulkan-drivers"
    folders = [Path(p) / "vulkan/icd.d" for p in ("/usr/share", "/etc", "/usr/local/share")]
    named = os.environ.get("VK_ICD_FILENAMES") or os.environ.get("VK_DRIVER_FILES")
    found = named or any(any(f.glob("*.json")) for f in folders)
    return None if found else "no Vulkan driver: install the package mesa-vulkan-drivers"


def environment(**more: str) -> dict[str, str]:
    """Of a viewer that sends nothing about its use."""
    return {**os.environ, "CI": "1", "RUST_LOG": "warn", **more}


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


class Patient:
    """Rerun's client, asking a busy viewer again: Rerun gives it 15 s for an answer and no more.
    :class:`ViewerError` where it has ended, or does not answer for :data:`WAIT`."""

    def __init__(self, client: Any, process: subprocess.Popen[bytes]) -> None:
        self._client, self._process = client, process

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def ask(*args: Any, **options: Any) -> Any:
            with ended_after(WAIT, self._process) as silent:
                while True:
                    try:
                        with suppress(TimeoutError):
                            return getattr(self._client, name)(*args, **options)
                    except ConnectionError:
                        late = f"has not answered for {WAIT:.0f} s", "try again when the machine is less busy"
                        ended = "ended by itself", "see that Vulkan works here and that memory suffices"
                        what, do = late if silent.is_set() else ended
                        raise ViewerError(f"the viewer {what}", do=do) from None

        return ask


@contextmanager
def ended_after(seconds: float, process: subprocess.Popen[bytes]) -> Iterator[threading.Event]:
    """Kill the viewer after so long, and set the event: Rerun's client waits for a frozen one for ever."""
    silent = threading.Event()

    def end() -> None:
        silent.set()
        process.kill()

    timer = threading.Timer(seconds, end)
    timer.start()
    try:
        yield silent
    finally:
        timer.cancel()


def span(client: Any) -> tuple[int, int]:
    """First and last time [ns] of the active timeline of a running viewer."""
    recording = client.get_state().recordings[0]
    line = next(t for t in recording.timelines if t.name == recording.current_timeline)
    return line.start, line.end


def pause_at(client: Any, nanoseconds: int | None) -> None:
    """Stop at a time of the clock, or in the middle of the active timeline."""
    if nanoseconds is None:
        line, middle = client.get_state().recordings[0].current_timeline, sum(span(client)) // 2
    else:
        line, middle = TIMELINE, nanoseconds
    clock, passed = {"timestamp": np.datetime64(middle, "ns")}, {"duration": np.timedelta64(middle, "ns")}
    client.set_time(line, play_state="paused", **(clock if line == TIMELINE else passed))


@contextmanager
def open_headless(rrd: str | Path, size: tuple[int, int] = (1600, 900)) -> Iterator[Any]:
    """Rerun's client of a viewer of ``rrd``, for this machine only; :class:`ViewerError` if none runs."""
    from rerun.experimental import ViewerClient

    if (why := vulkan_missing()) is not None:
        raise ViewerError(f"cannot draw without a screen here: {why}")
    port, quiet = free_port(), subprocess.DEVNULL
    command = [
        str(binary()), "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size",
        f"{size[0]}x{size[1]}", "--hide-welcome-screen", "--memory-limit", "4GB", str(rrd),
    ]  # fmt: skip

    with tempfile.TemporaryDirectory(dir=scratch.folder()) as home:
        own = environment(HOME=home, XDG_RUNTIME_DIR=home)
        process = subprocess.Popen(command, env=own, stdout=quiet, stderr=quiet)
        try:
            opened = False
            with ended_after(WAIT, process) as silent:
                while not opened:
                    if process.poll() is not None:
                        late = f" in {WAIT:.0f} s" if silent.is_set() else ""
                        do = "see that Vulkan works here (vulkaninfo)"
                        raise ViewerError(f"the viewer did not open {rrd}{late}", do=do)
                    time.sleep(0.1)
                    with suppress(ConnectionError, TimeoutError):
                        client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                        state = client.get_state()
                        opened = state.recordings and state.recordings[0].timelines and not state.loading
            yield Patient(client, process)
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(20)
            process.kill()
            process.wait()


def screenshot(rrd: str | Path, out: str | Path, *, at: int | None = None, settle: float = 7.0) -> Path:
    """The window as PNG at time ``at`` [ns], else the recording's middle, ``settle`` [s] after it is set."""
    with open_headless(rrd) as client:
        pause_at(client, at)
        client.take_screenshot()
        time.sleep(settle)
        Path(out).write_bytes(client.take_screenshot())
    return Path(out)
