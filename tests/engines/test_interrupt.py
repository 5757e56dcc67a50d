"""A run that is torn down leaves nothing half-written and nobody behind."""

import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
ENTRY = tomllib.loads(PROJECT.read_text())["project"]["scripts"]["fleetlog"].split(":")


def descendants(pid):
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    except OSError:
        return set()
    mine = {int(p) for p in text.split()}
    return mine.union(*(descendants(p) for p in mine))


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGKILL, -9)],
    ids=lambda v: str(v),
)
def test_torn_down(number, status, logs, project_root, tmp_path):
    words = [sys.executable, "-m", "fleetlog", "import", logs, "--site", project_root / "sample_data" / "site.toml",
             "--workers", "2", "-q", "-o", tmp_path / "out"]  # fmt: skip
    run = subprocess.Popen([str(w) for w in words], stderr=subprocess.PIPE, start_new_session=True)
    until = time.monotonic() + 60.0
    while len(workers := descendants(run.pid)) < 2 and run.poll() is None and time.monotonic() < until:
        time.sleep(0.002)
    assert len(workers) == 2
    os.kill(run.pid, number)
    error = run.communicate(timeout=30)[1].decode()
    assert run.returncode == status
    until = time.monotonic() + 10.0
    while any(map(alive, workers)) and time.monotonic() < until:
        time.sleep(0.01)
    assert not any(map(alive, workers))
    assert not (tmp_path / "out").exists()
    if number != signal.SIGKILL:
        assert list(tmp_path.iterdir()) == [] and "interrupted; nothing was written" in error


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("module", ["click", "fleetlog.api.verb", "fleetlog.registry"])
def test_an_interrupt_while_the_command_line_loads(module, tmp_path):
    """It comes as the module does, and is one line."""
    code = f"""
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from {ENTRY[0]} import {ENTRY[1]} as entry
entry()
"""
    done = subprocess.run([sys.executable, "-c", code, "info", "x"], capture_output=True, text=True)
    assert done.returncode == 130 and done.stderr == "fleetlog: interrupted; nothing was written\n"
