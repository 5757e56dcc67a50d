"""The real viewer without a screen: a recording is opened and painted by the processor (Mesa lavapipe).

All that fleetlog uses of ``rerun.experimental`` is here, because it may change with every release.
"""

import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog.errors import FleetlogError
from fleetlog.view.stream import TIMELINE

WAIT = 60.0  # Longest wait for the viewer [s]


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


class Viewer:
    """A running headless viewer with a recording open; ``client`` is that of Rerun."""

    def __init__(self, client: Any) -> None:
        self.client = client

    @property
    def state(self) -> Any:
        """The viewer's own account of recordings and views."""
        return self.client.get_state()

    def span(self) -> tuple[int, int]:
        """First and last time [ns] of the active timeline."""
        recording = self.state.recordings[0]
        line = next(t for t in recording.timelines if t.name == recording.current_timeline)
        return line.start, line.end

    def pause_at(self, nanoseconds: int | None) -> None:
        """Stop at a time of the clock, or in the middle of the active timeline."""
        if nanoseconds is None:
            line, middle = self.state.recordings[0].current_timeline, sum(self.span()) // 2
        else:
            line, middle = TIMELINE, nanoseconds
        clock, passed = {"timestamp": np.datetime64(middle, "ns")}, {"duration": np.timedelta64(middle, "ns")}
        self.client.set_time(line, play_state="paused", **(clock if line == TIMELINE else passed))

    def picture(self) -> bytes:
        """PNG of the whole window."""
        return bytes(self.client.take_screenshot())


@contextmanager
def open_headless(rrd: str | Path, size: tuple[int, int] = (1600, 900)) -> Iterator[Viewer]:
    """A viewer with ``rrd`` open, listening on this machine only; ViewerError where it cannot run."""
    from rerun.experimental import ViewerClient

    if (why := vulkan_missing()) is not None:
        raise ViewerError(f"cannot draw without a screen here: {why}")
    port, quiet = free_port(), subprocess.DEVNULL
    command = [
        str(binary()), "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size",
        f"{size[0]}x{size[1]}", "--hide-welcome-screen", "--memory-limit", "4GB", str(rrd),
    ]  # fmt: skip

    def opened() -> Viewer | None:
        """The viewer, once it has the recording."""
        viewer = Viewer(ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy"))
        state = viewer.state
        return viewer if state.recordings and state.recordings[0].timelines and not state.loading else None

    with tempfile.TemporaryDirectory() as home:
        own = environment(HOME=home, XDG_RUNTIME_DIR=home)
        process = subprocess.Popen(command, env=own, stdout=quiet, stderr=quiet)
        try:
            deadline, viewer = time.monotonic() + WAIT, None
            while viewer is None:
                if process.poll() is not None or time.monotonic() > deadline:
                    what, do = f"the viewer did not open {rrd}", "see that Vulkan works here (vulkaninfo)"
                    raise ViewerError(what, do=do)
                time.sleep(0.1)
                with suppress(ConnectionError):
                    viewer = opened()
            yield viewer
        finally:
            process.terminate()
            process.wait(20)


def screenshot(rrd: str | Path, out: str | Path, *, at: int | None = None, settle: float = 7.0) -> Path:
    """The whole window as PNG, at time ``at`` [ns] (the middle of the recording by default).

    ``settle`` seconds are given to load, and to let the notices of the viewer fade.
    """
    with open_headless(rrd) as viewer:
        viewer.pause_at(at)
        viewer.picture()
        time.sleep(settle)
        Path(out).write_bytes(viewer.picture())
    return Path(out)
