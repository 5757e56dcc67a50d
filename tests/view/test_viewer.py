"""The recordings in the real viewer, drawn without a screen: nothing blank, nothing reported."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fixtures_view import START, complaints, plant
from ink import colour_ink, is_drawn, views
from shapes import every_shape

from fleetlog.view import viewer
from fleetlog.view.results import write_result_recording

WHY = viewer.vulkan_missing()
needs_vulkan = pytest.mark.skipif(WHY is not None, reason=f"the viewer cannot draw here: {WHY}")
TEXT = {"Summary", "Answer"}


def assert_drawn(rrd: Path, second: float, expected: set[str]) -> None:
    with viewer.open_headless(rrd, (1200, 800)) as client:
        assert client.get_state().recordings[0].current_timeline == "utc"
        assert set(views(client)) == expected
        viewer.pause_at(client, (START + int(second * 1e6)) * 1000)
        blank = [name for name in expected - TEXT if not is_drawn(client, name)]
        assert not blank, f"nothing is drawn in {blank}"
        assert not complaints(client)


@needs_vulkan
def test_replay_is_drawn(replay: tuple[Path, Path]) -> None:
    views = {"Site", "Plan", "Map", "Speed [m/s]", "Battery power [kW]", "State of charge [%]", "Summary"}
    assert_drawn(replay[1], 78.0, views)


@needs_vulkan
def test_result_is_drawn(tmp_path: Path) -> None:
    out = write_result_recording(every_shape(), plant(), tmp_path / "r.rrd")
    assert_drawn(out, 60.0, {"Heat", "Residual", "Power [kW]", "Answer"})


def test_ink_tells_a_drawn_view_from_a_blank_one() -> None:
    import io

    from PIL import Image

    def png(rgb: np.ndarray) -> bytes:
        out = io.BytesIO()
        Image.fromarray(rgb.astype(np.uint8)).save(out, "png")
        return out.getvalue()

    grey = np.full((50, 50, 3), 90)
    assert colour_ink(png(grey)) == 0.0
    grey[:5, :5] = (230, 60, 40)
    assert colour_ink(png(grey)) == pytest.approx(0.01)


def test_missing_vulkan_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    with (
        pytest.raises(viewer.ViewerError, match="mesa-vulkan-drivers") as error,
        viewer.open_headless(tmp_path / "x.rrd"),
    ):
        pass
    assert "\n" not in error.value.line()


class Faulty:
    """A client whose first answers are these faults; None: none before its viewer has ended, as if frozen."""

    def __init__(self, process: subprocess.Popen[bytes], *faults: type[OSError] | None) -> None:
        self.process, self.faults = process, list(faults)

    def get_state(self) -> str:
        if not self.faults:
            return "state"
        if (fault := self.faults.pop(0)) is None:
            self.process.wait(30)
            raise ConnectionError("transport error")
        raise fault("Deadline expired before operation could complete")


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    """What stands for the viewer's process."""
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as running:
        yield running
        running.kill()


@pytest.mark.parametrize(
    ("fault", "said"), [(None, "not answered for 1 s.*less busy"), (ConnectionError, "ended by itself")]
)
def test_a_viewer_that_does_not_answer_is_one_line_with_advice(monkeypatch, process, fault, said) -> None:
    monkeypatch.setattr(viewer, "WAIT", 0.6)
    with pytest.raises(viewer.ViewerError, match=said):
        viewer.Patient(Faulty(process, TimeoutError, fault), process).get_state()
    assert (process.poll() is None) == (fault is not None)


def test_a_busy_viewer_is_asked_again(process: subprocess.Popen[bytes]) -> None:
    assert viewer.Patient(Faulty(process, TimeoutError, TimeoutError), process).get_state() == "state"


def test_viewer_sends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CI", raising=False)
    assert viewer.environment()["CI"] == "1" and os.environ.get("CI") is None
