from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def replay(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A dataset of three trucks and its recording."""
    from fixtures_view import plant, write_fleet

    from fleetlog.view.recording import write_recording

    folder = tmp_path_factory.mktemp("replay")
    dataset = write_fleet(folder / "dataset", plant())
    return dataset, write_recording(dataset, folder / "out.rrd")
