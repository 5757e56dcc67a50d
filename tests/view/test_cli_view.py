"""``fleetlog view`` as a user meets it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from ink import INK, colour_ink

from fleetlog.cli.main import load_verb
from fleetlog.errors import FleetlogError
from fleetlog.view import viewer
from fleetlog.view.viewer import ViewerError


def run(*arguments: str) -> str:
    outcome = CliRunner().invoke(load_verb("view"), list(arguments), standalone_mode=False)
    if outcome.exception:
        raise outcome.exception
    return outcome.output


@pytest.fixture
def dataset(tmp_path: Path, replay: tuple[Path, Path]) -> Path:
    return shutil.copytree(replay[0], tmp_path / "dataset")


def test_without_a_screen_it_says_what_to_do(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "has_screen", lambda: False)
    with pytest.raises(ViewerError, match=r"no screen.*--screenshot") as error:
        run(str(dataset))
    assert ".rrd" not in error.value.line()  # the file of a map or of one day is gone when the line is read


def test_viewer_is_started_on_this_machine_only(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[list[str], dict[str, str]]] = []
    monkeypatch.setattr(viewer, "has_screen", lambda: True)
    monkeypatch.setattr(viewer.subprocess, "call", lambda c, env: calls.append((c, env)) or 0)
    run(str(dataset))
    ((line, env),) = calls
    assert Path(line[0]).exists() and line[line.index("--bind") + 1] == "127.0.0.1"
    assert line[-1] == str(dataset / "recording.rrd") and env["CI"] == "1"


def test_recording_is_made_when_missing_or_old_and_only_then(dataset: Path) -> None:
    said: list[str] = []
    rrd = viewer.recording_of(dataset, say=said.append)
    assert said == [f"making {rrd}"] and rrd.read_bytes()[:4] == b"RRF2"
    viewer.recording_of(dataset, say=said.append)
    assert len(said) == 1
    os.utime(rrd, (1e9, 1e9))
    viewer.recording_of(dataset, say=said.append)
    assert len(said) == 2


def test_two_datasets_side_by_side(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import rrd

    both, drawn = tmp_path / "both.rrd", []
    monkeypatch.setattr(viewer, "screenshot", lambda rrd, out, at: drawn.append(rrd) or out.touch())
    run(str(dataset), "--beside", str(dataset), "--save", str(both), "--screenshot", str(tmp_path / "x.png"))
    # The viewer opens no file of another ending.
    assert drawn[0].suffix == ".rrd" and both.read_bytes() == drawn[0].read_bytes()
    assert {"/recorded/trucks/truck\\ 1", "/simulated/trucks/truck\\ 1"} <= rrd.entities(both)
    with pytest.raises(click.UsageError, match="--beside"):
        run(str(dataset), "--save", str(both))


@pytest.mark.parametrize("content", [None, b"", b"vehicle_id,timestamp\n"])
def test_anything_else_is_one_clear_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "thing"
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(FleetlogError, match=r"thing.*(dataset|columns)") as error:
        run(str(path))
    assert "\n" not in error.value.line()


@pytest.mark.skipif(
    viewer.vulkan_missing() is not None, reason=f"the viewer cannot draw here: {viewer.vulkan_missing()}"
)
def test_screenshot(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(viewer.screenshot.__kwdefaults__, "settle", 2.0)
    out = tmp_path / "shot.png"
    run(str(dataset), "--screenshot", str(out), "--at", "2026-03-02T06:01:18")
    assert colour_ink(out.read_bytes()) > 5 * INK


@pytest.mark.parametrize("name", ["site.toml", "roads.geojson", "logs/T8.nmea.gz"])
def test_maps_and_logs_are_seen_before_an_import(
    project_root: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rrd

    from fleetlog.view import viewer

    shown: list[Path] = []
    monkeypatch.setattr(viewer, "show", shown.append)
    run(str(project_root / "sample_data" / name))
    assert ("/trucks/T8" if "T8" in name else "/site/roads/surface") in rrd.entities(shown[0])
