"""Datasets of drawn trucks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from fleetlog.core.site import Frame, Site
from fleetlog.core.trajectory import Trajectory
from fleetlog.store import Dataset, DatasetWriter

Write = Callable[..., Dataset]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def make(trucks: Sequence[Trajectory], site: Site | None = None, name: str = "d") -> Dataset:
        site = site or Site("plant", Frame(50.0, 9.0, timezone="Europe/Berlin"))
        with DatasetWriter.create(tmp_path / name, "recorded", site) as w:
            for t in trucks:
                w.write(t)
        return Dataset(tmp_path / name)

    return make
