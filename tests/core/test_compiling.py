"""Kernels on disk are those of this version, whatever was installed before."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import CacheImpl

from fleetlog.compiling import kernel, stamp

KERNEL = """
from fleetlog.compiling import kernel
from records import Record{name}

@kernel()
def value(record):
    return record.one
"""
CALL = "from own import value; from records import Record{name}; print(value(Record{name}(7)))"


def run(folder: Path, name: str) -> str:
    """Compile or load a kernel over a record of that name, in a process of its own."""
    (folder / "records.py").write_text(
        f"from typing import NamedTuple\nclass Record{name}(NamedTuple):\n    one: int\n"
    )
    own = folder / "own.py"
    own.write_text(KERNEL.format(name=name))
    os.utime(own, (1e9, 1e9))
    code = f"import fleetlog.compiling as c; c.stamp = lambda package: {name!r}; " + CALL.format(name=name)
    path = os.pathsep.join([str(folder), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_record_that_was_renamed_does_not_end_the_next_version(tmp_path: Path) -> None:
    assert run(tmp_path, "A") == "7"
    (index,) = (tmp_path / "__pycache__").glob("*.nbi")
    with index.open("rb") as f:
        assert pickle.load(f).endswith(" A")
    assert run(tmp_path, "B") == "7"


def test_any_file_of_kernels_counts(tmp_path: Path) -> None:
    files = [
        tmp_path / name for name in ("a/kernels/one.py", "a/kernels.py", "b/kernels/two.py", "b/other.py")
    ]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("x = 1\n")
    stamps = [stamp.__wrapped__(tmp_path)]
    for file in files:
        file.write_text("x = 12\n")
        stamps.append(stamp.__wrapped__(tmp_path))
    assert len(set(stamps)) == 4 and stamps[-1] == stamps[-2]


def test_two_processes_that_compile_a_kernel_at_once_do_not_mix_up_its_types(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "twice.py").write_text(
        "from fleetlog.compiling import kernel\n\n@kernel()\ndef first(values):\n    return values[0]\n"
    )
    import twice  # type: ignore[import-not-found]

    ours, theirs = (kernel()(twice.first.py_func)._cache._cache_file for _ in range(2))
    monkeypatch.setattr(theirs, "_load_index", dict)  # they read it before we wrote
    for step in ("_load_index", "_save_index", "_save_data"):
        ours.flush()
        with monkeypatch.context() as patched:
            done = getattr(ours, step)
            patched.setattr(ours, step, lambda *a, done=done: (theirs.save("two", "their code"), done(*a))[1])
            ours.save("one", "our code")
        assert ours.load("one") in ("our code", None) and ours.load("two") in ("their code", None)


def test_functions_of_one_name_that_two_processes_compiled_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "alike.py").write_text(
        "from fleetlog.compiling import kernel\n\n"
        "def made(value):\n"
        "    @kernel()\n"
        "    def inner(n):\n"  # it calls itself twice, so it is not written into its caller
        "        return value if n < 2 else inner(n - 1) + inner(n - 2)\n\n"
        "    return inner\n\n"
        "first, second = made(1), made(10)\n\n"
        "@kernel()\ndef one(n):\n    return first(n)\n\n"
        "@kernel()\ndef ten(n):\n    return second(n)\n"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = [
        subprocess.run(
            [sys.executable, "-c", f"import alike; print({called})"],
            env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=True,
        ).stdout.strip()
        for called in ("alike.one(5)", "alike.ten(5)", "alike.one(5), alike.ten(5)")
    ]  # fmt: skip
    assert done == ["8", "80", "8 80"]


def test_kernels_run_where_nothing_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    assert kernel()(lambda x: x + 1)(6) == 7
