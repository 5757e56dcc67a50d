"""Real CSV logs, with what is known about them, and the profile of the documentation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fleetlog.core.site import Site
from fleetlog.importers._profile import load_profile
from fleetlog.importers.base import importers
from fleetlog.ingest.pipeline import import_logs
from fleetlog.ingest.summary import ImportSummary
from fleetlog.store import Dataset, DatasetWriter


def run(path: Path, out: Path, **options: Any) -> tuple[Dataset, ImportSummary]:
    with DatasetWriter.create(out, "recorded", Site()) as writer:
        summary = import_logs([path], None, writer, **options)
    return Dataset(out), summary


@pytest.fixture(scope="module")
def pages(project_root: Path) -> str:
    return (project_root / "docs" / "logs.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def twizy(
    shared_data: Path, pages: str, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Dataset, ImportSummary]:
    folder = tmp_path_factory.mktemp("twizy")
    found = re.search(r"```toml\n(# profile: twizy.*?)```", pages, re.S)
    assert found
    (folder / "twizy.toml").write_text(found[1])
    return run(shared_data / "twizy", folder / "out", profile=load_profile(folder / "twizy.toml"))


def test_the_worked_profile_gives_what_the_page_says(
    twizy: tuple[Dataset, ImportSummary], pages: str
) -> None:
    dataset, summary = twizy
    for line in summary.lines():
        if "rows" in line and "profile" not in line:
            assert line.strip() in pages, line
    assert dataset.vehicles == ["twizy"]


def test_twizy_positions_move_as_its_speed_says(twizy: tuple[Dataset, ImportSummary]) -> None:
    dataset, _ = twizy
    t = dataset.read("twizy")
    assert 0.1 < np.nanmin(t.floats("soc")) < np.nanmax(t.floats("soc")) <= 1.0
    assert np.nanmin(t.floats("z")) > -100.0
    x, y, speed, s = t.floats("x"), t.floats("y"), t.floats("speed"), t.seconds()
    known = np.isfinite(x)
    assert known.mean() > 0.97
    step, dt = np.hypot(np.diff(x), np.diff(y)), np.diff(s)
    fine = np.isfinite(step) & (dt < 1.5) & (speed[1:] > 5)
    # Chords between fixes, and a speed that reads 2 % low, against one another.
    assert 0.95 < step[fine].sum() / (speed[1:] * dt)[fine].sum() < 1.05
    assert np.quantile(step[fine], 0.999) < 35.0


def test_tripviewer(shared_data: Path, tmp_path: Path) -> None:
    dataset, summary = run(shared_data / "tripviewer", tmp_path / "out")
    assert not summary.damaged and summary.derived == ["battery_power", "heading"]
    t = dataset.read(dataset.vehicles[0])
    step = np.hypot(np.diff(t.floats("x")), np.diff(t.floats("y")))
    assert 125e3 < step.sum() < 145e3  # 140 km of motorway
    driven = (t.floats("speed")[1:] * np.diff(t.seconds())).sum()
    assert driven == pytest.approx(step.sum(), rel=0.05)
    assert t.floats("battery_power")[0] == pytest.approx(384.77 * 55.175)
    assert t.floats("z")[0] == pytest.approx(1932 * 0.3048)
    assert t.floats("ambient_temperature")[0] == pytest.approx((77.9 - 32) / 1.8)
    assert "odo_km" in t and "torque" in t


def test_escooter_speed_is_noticed(shared_data: Path, tmp_path: Path) -> None:
    """The columns do not say it, but the speed is in km/h: it is 3.3 times that of the positions."""
    dataset, summary = run(shared_data / "escooter", tmp_path / "out")
    assert len(dataset.vehicles) == 30
    assert any("km/h" in note for note in summary.notes)
    assert any(f.file == "escooter_summary.csv" and f.damage for f in summary.files)


@pytest.mark.parametrize("case", ["none", "grade"])
def test_blind(shared_data: Path, tmp_path: Path, case: str) -> None:
    folder = shared_data / "blind" / case
    from fleetlog.roads import load_site

    site, _ = load_site(folder / "site.toml")
    with DatasetWriter.create(tmp_path / "out", "recorded", site) as writer:
        summary = import_logs([folder / "recorded.csv.gz"], site, writer)
    assert not summary.damaged and summary.rows == summary.rows_read
    assert summary.matched is not None and summary.matched > 0.99
    assert not [n for n in summary.notes if "unit" in n]


def test_the_page_lists_every_format(pages: str) -> None:
    table = set(re.findall(r"^\| ([a-z0-9-]+) \|", pages, re.M))
    assert set(importers()) <= table
