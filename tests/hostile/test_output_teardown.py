"""A short version of the tear-down script: two verbs, one round of each trial."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import teardown

SHORT = {
    "import": ("kill", "term", "ulimit", "disk"),
    "export-csv": ("race", "streams", "input", "read-only"),
}


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, teardown.Case]:
    inputs = tmp_path_factory.mktemp("inputs")
    teardown.prepare(inputs)
    return {v: teardown.case_of(v, inputs, tmp_path_factory.mktemp(v)) for v in SHORT}


@pytest.mark.parametrize(("verb", "trial"), [(v, t) for v, trials in SHORT.items() for t in trials])
def test_an_output_is_whole_or_not_there(cases: dict[str, teardown.Case], verb: str, trial: str) -> None:
    if trial in teardown.MOUNTS and not teardown.can_mount():
        pytest.skip("this machine lets nothing be mounted")
    assert teardown.TRIALS[trial](cases[verb], random.Random(7)) is None
