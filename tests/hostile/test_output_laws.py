"""Laws of outputs: whole or not at all, at every instant; only an older output of the same kind is replaced."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from fleetlog.errors import OutputError
from fleetlog.store import output
from fleetlog.store.output import MARK, atomic_output

ROOT = Path(__file__).resolve().parents[2]


def write(target: Path, text: str, kind: str = "thing", **how: object) -> None:
    """An output of two files, or of one."""
    with atomic_output(target, kind, **how) as scratch:
        if how.get("folder", True):
            (scratch / "a").write_text(text)
            (scratch / "sub").mkdir()
            (scratch / "sub" / "b").write_text(text)
        else:
            scratch.write_text(text)


def read(target: Path) -> str | None:
    """The text of an output that is whole, None where there is none."""
    if target.is_dir():
        texts = {(target / n).read_text() for n in ("a", "sub/b")}
        assert len(texts) == 1 and (target / MARK).is_file()
        return texts.pop()
    return target.read_text() if target.exists() else None


KILLED = """
import os, sys
from pathlib import Path
sys.path.insert(0, {root!r})
from fleetlog.store import output
from tests.hostile.test_output_laws import write
if {fallback}:
    output._renameat2 = lambda *a: False
left = int(sys.argv[1])
def die(event, args):
    global left
    if event.startswith("os.") or event in ("open", "ctypes.dlsym", "shutil.rmtree"):
        left -= 1
        if left < 0:
            os._exit(9)
sys.addaudithook(die)
write(Path(sys.argv[2]), "new", overwrite=True, folder={folder})
"""
FORKED = """
import os, sys
sys.path.insert(0, {root!r})
import fleetlog.store.output, fleetlog.interrupt, fcntl, hashlib, json, ctypes
import tests.hostile.test_output_laws
CODE = {code!r}
for k in range(int(sys.argv[1])):
    pid = os.fork()
    if not pid:
        sys.argv[1:] = [str(k), sys.argv[2] + str(k)]
        exec(CODE, {{"__name__": "killed"}})
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""


@pytest.mark.parametrize("folder", [True, False])
@pytest.mark.parametrize("fallback", [False, True])
def test_killed_before_any_of_its_system_calls_a_run_leaves_the_older_or_the_newer(
    tmp_path: Path, folder: bool, fallback: bool
) -> None:
    """Without an exchange of folders the older one may be set aside just then; the next run puts it back."""
    most = 90
    for k in range(most):
        write(tmp_path / f"out{k}", "old", folder=folder)
    code = KILLED.format(root=str(ROOT), fallback=fallback, folder=folder)
    script = FORKED.format(root=str(ROOT), code=code)
    done = subprocess.run(
        [sys.executable, "-c", script, str(most), str(tmp_path / "out")],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    statuses = [int(s) for s in done.stdout.split()]
    assert statuses[0] == 9 and statuses[-1] == 0 and set(statuses) == {0, 9}, "not every instant was tried"
    seen = set()
    for k in range(most):
        target = tmp_path / f"out{k}"
        found = read(target)
        aside = tmp_path / f".out{k}.partial" / "old"
        assert found in ("old", "new") or (fallback and folder and aside.is_dir()), k
        seen.add(found)
        write(target, "third", overwrite=True, folder=folder)
        assert read(target) == "third"
    assert {"old", "new"} <= seen and (None in seen) == (fallback and folder)
    assert not list(tmp_path.glob(".*.partial"))


def test_an_older_output_that_was_set_aside_comes_back_even_if_the_next_run_fails(tmp_path: Path) -> None:
    write(tmp_path / "out", "old")
    scratch = tmp_path / ".out.partial"
    scratch.mkdir()
    (scratch / "lock").touch()
    (tmp_path / "out").rename(scratch / "old")
    with pytest.raises(ZeroDivisionError), atomic_output(tmp_path / "out", "thing"):
        raise ZeroDivisionError
    assert read(tmp_path / "out") == "old"


@pytest.mark.parametrize("folder", [True, False])
def test_only_an_older_output_of_the_same_kind_is_replaced(tmp_path: Path, folder: bool) -> None:
    target = tmp_path / "out"
    write(target, "old", folder=folder)
    with pytest.raises(OutputError, match="--overwrite"):
        write(target, "new", folder=folder)
    with pytest.raises(OutputError, match="another command"):
        write(target, "new", "other", folder=folder, overwrite=True)
    with pytest.raises(OutputError, match="is to be written"):
        write(target, "new", folder=not folder, overwrite=True)
    assert read(target) == "old"
    write(target, "new", folder=folder, overwrite=True)
    assert read(target) == "new"


def test_what_somebody_else_put_there_is_not_replaced(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "recording.rrd").write_text("the only one")
    (mine / "dataset.json").write_text("{}")
    with pytest.raises(OutputError, match="not made by fleetlog"):
        write(mine, "new", overwrite=True)
    several = tmp_path / "several"
    for name in "ab":
        write(several / name, "old")
    with pytest.raises(OutputError, match="not made by fleetlog"):
        write(several, "new", overwrite=True)
    write(tmp_path / "out", "old")
    (tmp_path / "out" / "notes.txt").write_text("kept")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        write(tmp_path / "out", "new", overwrite=True)
    write(tmp_path / "file", "old", folder=False)
    (tmp_path / "file").write_text("edited")
    with pytest.raises(OutputError, match="changed since"):
        write(tmp_path / "file", "new", folder=False, overwrite=True)
    assert (tmp_path / "file").read_text() == "edited" and (tmp_path / "out" / "notes.txt").exists()
    assert read(several / "a") == "old" and (mine / "recording.rrd").read_text() == "the only one"


def test_an_empty_folder_is_free_for_the_taking(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write(tmp_path / "out", "new", overwrite=True)
    assert read(tmp_path / "out") == "new"


@pytest.mark.parametrize("folder", [True, False])
def test_devices_pipes_and_sockets_stay(tmp_path: Path, folder: bool) -> None:
    os.mkfifo(tmp_path / "fifo")
    with socket.socket(socket.AF_UNIX) as s:
        s.bind(str(tmp_path / "socket"))
        for path in (tmp_path / "fifo", tmp_path / "socket", Path("/dev/null")):
            before = path.stat().st_mode
            with pytest.raises(OutputError, match="device"):
                write(path, "new", folder=folder, overwrite=True)
            assert path.stat().st_mode == before
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


@pytest.mark.parametrize("folder", [True, False])
def test_a_symlink_stays_one_and_what_it_names_is_replaced_or_refused(tmp_path: Path, folder: bool) -> None:
    real, link = tmp_path / "there" / "real", tmp_path / "link"
    link.symlink_to(real)
    write(link, "old", folder=folder)
    assert link.is_symlink() and read(real) == "old"
    write(link, "new", folder=folder, overwrite=True)
    assert link.is_symlink() and read(real) == "new"
    foreign = tmp_path / "foreign"
    foreign.write_text("mine") if not folder else (foreign.mkdir(), (foreign / "x").touch())
    (tmp_path / "second").symlink_to(foreign)
    with pytest.raises(OutputError, match="not made by fleetlog"):
        write(tmp_path / "second", "new", folder=folder, overwrite=True)


def test_an_output_is_never_an_input(tmp_path: Path) -> None:
    data = tmp_path / "data"
    write(data, "old", "recorded dataset")
    (data / "dataset.json").touch()
    (tmp_path / "alias").symlink_to(data)
    for target, source in (
        (data, data), (data, data / "a"), (tmp_path / "alias", data), (data, tmp_path / "alias" / "a"),
        (data / "trajectories", data), (data / "new", tmp_path / "alias"), (tmp_path, data),
    ):  # fmt: skip
        with pytest.raises(OutputError, match="this run reads"):
            write(target, "new", "recorded dataset", overwrite=True, inputs=[source])
    logs = tmp_path / "logs"
    logs.mkdir()
    write(logs / "dataset", "new", inputs=[logs])  # beside the logs in their folder
    assert read(logs / "dataset") == "new" and read(data) == "old"


def test_of_two_runs_to_one_place_the_second_fails_at_once(tmp_path: Path) -> None:
    inside, finish = threading.Event(), threading.Event()

    def first() -> None:
        with atomic_output(tmp_path / "out", "thing") as scratch:
            inside.set()
            finish.wait(20)
            (scratch / "a").write_text("first")

    thread = threading.Thread(target=first)
    thread.start()
    assert inside.wait(20)
    with pytest.raises(OutputError, match="another run"):
        write(tmp_path / "out", "second")
    finish.set()
    thread.join()
    assert (tmp_path / "out" / "a").read_text() == "first" and not list(tmp_path.glob(".out*"))


def test_what_came_into_the_place_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with pytest.raises(OutputError, match="already there"), atomic_output(target, "thing"):
        target.mkdir()
        (target / "mine").touch()
    with (
        pytest.raises(OutputError, match="not made by fleetlog"),
        atomic_output(target, "thing", overwrite=True),
    ):
        pass
    assert (target / "mine").exists() and not list(tmp_path.glob(".out*"))


def test_a_folder_of_the_name_of_the_scratch_is_not_cleared(tmp_path: Path) -> None:
    (tmp_path / ".out.partial").mkdir()
    (tmp_path / ".out.partial" / "mine").touch()
    with pytest.raises(OutputError, match="in the way"):
        write(tmp_path / "out", "new")
    assert (tmp_path / ".out.partial" / "mine").exists()


def test_parents_are_made_and_go_with_a_run_that_fails(tmp_path: Path) -> None:
    write(tmp_path / "a" / "b" / "c", "new")
    assert read(tmp_path / "a" / "b" / "c") == "new"
    with pytest.raises(ZeroDivisionError), atomic_output(tmp_path / "x" / "y" / "z", "thing"):
        raise ZeroDivisionError
    assert not (tmp_path / "x").exists()


def test_a_full_disk_names_the_output(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match="out: not written: No space left"),
        atomic_output(tmp_path / "out", "thing"),
    ):
        raise OSError(28, "Error writing bytes to file")
    with pytest.raises(OSError, match="elsewhere"), atomic_output(tmp_path / "out", "thing"):
        raise OSError(28, "No space left on device", "elsewhere")


def test_locks_that_a_file_system_does_not_know_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    def refuse(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(OutputError, match="cannot be locked"):
        write(tmp_path / "out", "new")
    assert output._names(tmp_path) in ([], [".out.partial"])


ORPHANED = """
import os, sys, time
from pathlib import Path
from contextlib import closing
from fleetlog.engines.processes import Processes
from fleetlog.store.output import atomic_output
def work(seconds):
    print(os.getpid(), flush=True)
    time.sleep(seconds)
with atomic_output(Path(sys.argv[1]), "thing"):
    if sys.argv[2] == "fork":
        if not os.fork():
            time.sleep(10)
        os._exit(9)
    with closing(Processes(2, always=True).run(work, [0, 60, 60])) as results:
        next(results)
        if sys.argv[2] == "raise":
            raise ZeroDivisionError
        next(results)
"""


def orphan(target: Path, how: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", ORPHANED, str(target), how],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT,
    )  # fmt: skip


def test_a_worker_that_outlives_a_killed_run_does_not_hold_its_place(tmp_path: Path) -> None:
    run = orphan(tmp_path / "out", "fork")
    assert run.wait(20) == 9
    write(tmp_path / "out", "new")
    assert read(tmp_path / "out") == "new"


def gone(pid: int) -> bool:
    for _ in range(100):
        state = Path(f"/proc/{pid}/stat")
        if not state.exists() or state.read_text().split()[2] == "Z":
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(sys.platform != "linux", reason="workers are told of their parent's end on Linux only")
def test_workers_end_with_their_run(tmp_path: Path) -> None:
    run = orphan(tmp_path / "out", "wait")
    assert run.stdout is not None
    worker = int(run.stdout.readline())
    run.kill()
    run.wait(20)
    assert gone(worker)


def test_workers_end_at_once_with_a_run_that_fails(tmp_path: Path) -> None:
    run = orphan(tmp_path / "out", "raise")
    assert run.wait(20) == 1 and not list(tmp_path.iterdir())
