"""Fixtures that every test folder shares."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

# BLAS threads that spin on a busy machine cost more than they give; set before numpy loads.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import pytest
from hypothesis import settings

# A busy machine must not make a law look broken.
settings.register_profile("fleetlog", deadline=None, print_blob=True)
settings.load_profile("fleetlog")


def pytest_configure(config: pytest.Config) -> None:
    """Files go to processes in the order below, not in that of how many tests they have."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with most slow proofs go first, so that no process has a long one left when the others are done."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real logs and maps beside the project."""
    if not SHARED.is_dir():
        pytest.skip("the real logs and maps (../shared/data) are not here")
    return SHARED


@pytest.fixture(scope="session")
def project_root() -> Path:
    return ROOT
