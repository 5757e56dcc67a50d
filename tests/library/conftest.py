"""The sample data as a folder of their own, and what came of them: made once."""

from __future__ import annotations

from pathlib import Path

import pytest

import fleetlog


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs, site and truck, as ``fleetlog demo --data`` writes them."""
    folder = tmp_path_factory.mktemp("library") / "sample"
    fleetlog.demo(data=folder)
    return folder


@pytest.fixture(scope="session")
def recorded(sample: Path) -> fleetlog.Result:
    """One log of the sample plant, imported."""
    return fleetlog.read_logs(sample / "logs" / "fleet.csv.gz", site=sample / "site.toml", recording=False)
