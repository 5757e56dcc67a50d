"""The real viewer without a screen: a recording is opened and painted by the processor (Mesa lavapipe).

All that fleetlog uses of ``rerun.experimental`` is here, because it may change with every release.
"""

import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fleetlog.errors import FleetlogError
from fleetlog.view.stream import TIMELINE

T = TypeVar("T")
WAIT = 60.0
"""Longest wait for the viewer [s]."""


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
    if os.environ.get("VK_ICD_FILENAMES") or os.environ.get("VK_DRIVER_FILES"):
        return None
    if not any(any(f.glob("*.json")) for f in folders if f.is_dir()):
        return "no Vulkan driver: install the package mesa-vulkan-drivers"
    return None


def environment(home: str | None = None) -> dict[str, str]:
    """Of a viewer that sends nothing about its use."""
    quiet = {**os.environ, "CI": "1", "RUST_LOG": "warn"}
    return quiet if home is None else {**quiet, "HOME": home, "XDG_RUNTIME_DIR": home}


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def _until(ask: Callable[[], T | None], what: str, process: subprocess.Popen[bytes]) -> T:
    deadline = time.monotonic() + WAIT
    while time.monotonic() < deadline:
        if process.poll() is not None:
            break
        try:
            answer = ask()
        except ConnectionError:
            answer = None
        if answer is not None:
            return answer
        time.sleep(0.1)
    raise ViewerError(f"the viewer {what}", do="see that Vulkan works here (vulkaninfo)")


class Viewer:
    """A running headless viewer with a recording open."""

    def __init__(self, client: Any, process: subprocess.Popen[bytes]) -> None:
        self.client, self._process = client, process

    @property
    def state(self) -> Any:
        """The viewer's own account of recordings and views."""
        return self.client.get_state()

    def span(self) -> tuple[int, int]:
        """First and last time [ns] of the active timeline."""
        recording = self.state.recordings[0]
        line = next(t for t in recording.timelines if t.name == recording.current_timeline)
        return line.start, line.end

    def pause_at(self, nanoseconds: int) -> None:
        """Set the time cursor on the clock's timeline and stop there."""
        self.client.set_time(TIMELINE, timestamp=np.datetime64(nanoseconds, "ns"), play_state="paused")

    def pause_in_the_middle(self) -> None:
        """Stop in the middle of the active timeline."""
        start, end = self.span()
        line, middle = self.state.recordings[0].current_timeline, start + (end - start) // 2
        if line == TIMELINE:
            self.pause_at(middle)
        else:
            self.client.set_time(line, duration=np.timedelta64(middle, "ns"), play_state="paused")

    def picture(self) -> bytes:
        """PNG of the whole window."""
        return bytes(self.client.take_screenshot())


@contextmanager
def open_headless(rrd: str | Path, size: tuple[int, int] = (1600, 900)) -> Iterator[Viewer]:
    """A viewer with ``rrd`` open, listening on this machine only; ViewerError where it cannot run."""
    from rerun.experimental import ViewerClient

    if (why := vulkan_missing()) is not None:
        raise ViewerError(f"cannot draw without a screen here: {why}")
    port = free_port()
    command = [
        str(binary()), "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size",
        f"{size[0]}x{size[1]}", "--hide-welcome-screen", "--memory-limit", "4GB", str(rrd),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as home:
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(command, env=environment(home), stdout=quiet, stderr=quiet)
        try:
            address = f"rerun+http://127.0.0.1:{port}/proxy"
            client = _until(lambda: ViewerClient.connect(address), "did not start", process)
            viewer = Viewer(client, process)
            _until(lambda: _ready(viewer), f"did not open {rrd}", process)
            yield viewer
        finally:
            process.terminate()
            process.wait(20)


def _ready(viewer: Viewer) -> bool | None:
    state = viewer.state
    return True if state.recordings and state.recordings[0].timelines and not state.loading else None


def screenshot(
    rrd: str | Path, out: str | Path, *, at: int | None = None, size: tuple[int, int] = (1600, 900),
    settle: float = 7.0,
) -> Path:  # fmt: skip
    """The whole window as PNG, at time ``at`` [ns] (the middle of the recording by default).

    ``settle`` seconds are given to load, and to let the notices of the viewer fade.
    """
    with open_headless(rrd, size) as viewer:
        if at is None:
            viewer.pause_in_the_middle()
        else:
            viewer.pause_at(at)
        viewer.picture()
        time.sleep(settle)
        Path(out).write_bytes(viewer.picture())
    return Path(out)
