"""What lies on a shelf comes back as it was."""

from __future__ import annotations

import json
import pickle
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleetlog import engines
from fleetlog.cli.main import cli as fleetlog
from fleetlog.core.truck import load_truck
from fleetlog.discovery.diagnose import diagnose
from fleetlog.discovery.recording.shelf import Shelf
from fleetlog.discovery.settings import SETTINGS
from fleetlog.store import Dataset

sys.path.insert(0, str(Path(__file__).parents[1] / "blind"))


def test_pieces_come_back_in_order_and_as_they_were() -> None:
    shelf = Shelf()
    pieces = [{"k": k, "values": np.random.default_rng(k).normal(size=50)} for k in range(12)]
    for k in reversed(range(12)):
        shelf.put("day", k, pieces[k])
    assert not shelf.has("day")
    shelf.end("day")
    assert shelf.has("day") and shelf.numbers("day") == list(range(12))
    for _ in range(2):
        for k, piece in enumerate(pieces):
            back = shelf.get("day", k)
            assert back["k"] == piece["k"] and np.array_equal(back["values"], piece["values"])


def test_one_value_repeated_stays_one_value() -> None:
    shelf = Shelf()
    shelf.put("day", 0, np.broadcast_to(np.float32(2.5), (1000,)))
    back = shelf.get("day", 0)
    assert back.strides == (0,) and back.shape == (1000,) and back[7] == 2.5


def test_files_go_with_the_shelf_that_made_them_and_not_with_a_copy() -> None:
    shelf = Shelf()
    shelf.put("day", 0, np.arange(3))
    copied = pickle.loads(pickle.dumps(shelf))
    folder = copied.folder
    del copied
    assert shelf.get("day", 0).tolist() == [0, 1, 2]
    del shelf
    assert not folder.exists()


def test_a_shelf_that_is_not_here_begins_anew() -> None:
    shelf = Shelf()
    copied = pickle.loads(pickle.dumps(shelf))
    shutil.rmtree(shelf.folder)
    assert not copied.has("day")
    copied.put("day", 0, 5)
    assert copied.get("day", 0) == 5 and pickle.loads(pickle.dumps(copied)).numbers("day") == [0]


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


def test_a_number_that_is_not_needed_goes_without_the_effect_of_its_pair(recorded: Path) -> None:
    """Slow turns with a load seem to be part of the laden speed until the cornering limit of all is told."""
    found = {f["term"]: f for f in json.loads(diagnosed(recorded, "pair"))["findings"]}
    assert found.keys() == {"laden_speed", "cornering_speed"}
    assert [p["name"] for p in found["laden_speed"]["parameters"]] == ["factor"]


def test_a_sample_of_a_large_recording_is_searched_alike_by_any_number_of_workers(recorded: Path) -> None:
    """What is found on a part of the trips is fitted to all of them."""

    def told(workers: int) -> dict[str, Any]:
        with engines.using(workers):
            truck = load_truck(recorded / "truck.toml")
            few = replace(SETTINGS, sample=600)
            return diagnose(Dataset(recorded / "data"), truck, settings=few).verdict.document()

    alone = told(1)
    assert told(2) == alone
    assert alone["verdict"] == "found"
    assert all(c["after"] is not None for c in alone["channels"])
