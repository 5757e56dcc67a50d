"""What lies on a shelf comes back as it was, be it in memory or on disk; a diagnosis does not hang on where."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from fleetlog.cli.main import cli as fleetlog
from fleetlog.core.trajectory import Trajectory
from fleetlog.discovery.recording import fleet
from fleetlog.discovery.recording.shelf import Shelf

sys.path.insert(0, str(Path(__file__).parents[1] / "blind"))


@pytest.mark.parametrize("on_disk", [False, True])
def test_pieces_come_back_in_order_and_as_they_were(on_disk: bool) -> None:
    shelf: Shelf[dict] = Shelf(on_disk)
    log = Trajectory("T1", np.arange(3), {})
    pieces = [{"k": k, "values": np.random.default_rng(k).normal(size=50), "log": log} for k in range(4)]
    for piece in pieces:
        shelf.add(piece)
    assert len(shelf) == 4
    for _ in range(2):
        for back, piece in zip(shelf, pieces, strict=True):
            assert back["k"] == piece["k"] and np.array_equal(back["values"], piece["values"])
            assert back["log"] is log  # What is in memory anyway is not written


def test_one_value_repeated_stays_one_value() -> None:
    shelf: Shelf[np.ndarray] = Shelf(on_disk=True)
    shelf.add(np.broadcast_to(np.float32(2.5), (1000,)))
    assert shelf[0].strides == (0,) and shelf[0].shape == (1000,) and shelf[0][7] == 2.5


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from recorder import record

    folder = tmp_path_factory.mktemp("shelf")
    record("laden_speed+cornering_speed,seed=4001,vehicles=3,hours=1.5", folder)
    log, site = str(folder / "recorded.csv.gz"), str(folder / "site.toml")
    fleetlog(
        ["import", log, "--site", site, "-o", str(folder / "data"), "-q", "--no-recording"],
        standalone_mode=False,
    )
    return folder


def diagnosed(folder: Path, name: str) -> str:
    call = ["diagnose", str(folder / "data"), "--truck", str(folder / "truck.toml"), "-o", str(folder / name)]
    fleetlog([*call, "-q", "--workers", "1"], standalone_mode=False)
    return (folder / name / "diagnosis.json").read_text()


def test_a_large_recording_is_diagnosed_as_a_small_one(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = diagnosed(recorded, "small")
    monkeypatch.setattr(fleet, "LARGE", 0)
    assert diagnosed(recorded, "large") == small


def test_a_number_that_is_not_needed_goes_without_the_effect_of_its_pair(recorded: Path) -> None:
    """Slow turns with a load seem to be part of the laden speed until the cornering limit of all is told."""
    found = {f["term"]: f for f in json.loads(diagnosed(recorded, "pair"))["findings"]}
    assert found.keys() == {"laden_speed", "cornering_speed"}
    assert [p["name"] for p in found["laden_speed"]["parameters"]] == ["factor"]
