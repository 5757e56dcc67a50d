"""Folders for what a run needs until it ends: gone when it ends, swept when it was killed, nothing else touched."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fleetlog import scratch

USE = "from fleetlog import scratch; (scratch.folder() / 'file').touch(); "
INTERRUPTED = """
from fleetlog import engines
from fleetlog.cli import main

def command(**_):
    scratch.folder()
    with engines.using(2) as engine:
        for _ in engine.run(lambda job: scratch.folder() and job, range(100)):
            raise KeyboardInterrupt

main.cli.main = command
main.entry()
"""


def run(code: str, place: Path) -> int:
    environment = {**os.environ, "TMPDIR": str(place), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", USE + code], env=environment, check=False, timeout=120)
    return done.returncode


@pytest.mark.parametrize("code", ["", "import os; os.fork() or os._exit(0); os.wait()", "1 / 0", INTERRUPTED])
def test_a_run_takes_its_folder_with_it(code: str, tmp_path: Path) -> None:
    run(code, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_next_run_sweeps_what_a_killed_one_left(tmp_path: Path) -> None:
    run("import os; os.kill(os.getpid(), 9)", tmp_path)
    assert len(list(tmp_path.glob("*/*/file"))) == 1
    run("", tmp_path)
    assert not list(tmp_path.iterdir())


def test_nothing_but_folders_of_the_dead_is_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratch.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(scratch, "_made", [])
    mine = scratch.folder()
    (tmp_path / "fleetlog-notes").mkdir()
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / scratch.MARK).touch()
    (tmp_path / "fleetlog-link").symlink_to(tmp_path / "theirs")
    (tmp_path / "fleetlog-linked").mkdir()
    (tmp_path / "fleetlog-linked" / scratch.MARK).symlink_to(tmp_path / "theirs" / scratch.MARK)
    before = sorted(tmp_path.rglob("*"))
    run("", tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    scratch.clear()
    assert not mine.exists()
