"""The package of docs/extend.md, installed as printed: one analysis, one log format, one term, by command and in Python."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "extend.md"


def blocks(kind: str) -> list[str]:
    """The code blocks of one kind, in order."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Path:
    """A folder with the package installed beside a log of its format, as the page tells."""
    folder = tmp_path_factory.mktemp("plugins")
    source = folder / "plantkit"
    (source / "plantkit").mkdir(parents=True)
    project, model = blocks("toml")
    (source / "pyproject.toml").write_text(project)
    (source / "plantkit" / "__init__.py").touch()
    for name, text in zip(("idle", "xyt", "trailer"), blocks("python"), strict=False):
        (source / "plantkit" / f"{name}.py").write_text(text)
    (folder / "model.toml").write_text(model)
    rows = [f"A {1_772_431_200 + k} {min(k, 60)} 0" for k in range(120)]
    (folder / "log.xyt").write_text("\n".join(["# xyt 1", *rows, "A broken row"]) + "\n")
    (folder / "sample").symlink_to(sample)
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
    ]
    subprocess.run([*install, "--target", folder / "installed", source], check=True, capture_output=True)
    return folder


def run(work: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python with the package on its path."""
    path = os.pathsep.join([str(work / "installed"), str(PAGE.parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=work,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )


def test_all_three_by_command(work: Path) -> None:
    lines = [
        line[2:] for text in blocks("console") for line in text.splitlines() if line.startswith("$ fleetlog")
    ]
    assert len(lines) == 3
    answers = []
    for line in lines:
        done = run(work, "-m", *line.split(), "--json")
        assert done.returncode == (3 if " import " in line else 0), done.stderr
        answers.append(json.loads(done.stdout))
    assert answers[0]["rejected"] == {"not vehicle, time, x, y": 1}
    assert 55 <= answers[1]["idle_s"] <= 62 and answers[1]["below_m_s"] == 0.2
    assert {p.name for p in (work / "idle").glob("[!.]*")} == {
        "idle.json", "idle.png", "vehicles.parquet", "recording.rrd",
    }  # fmt: skip
    listed, help_ = (
        run(work, "-m", "fleetlog", "analyze"),
        run(work, "-m", "fleetlog", "analyze", "idle", "-h"),
    )
    assert "Idle time: how long every truck stands" in listed.stdout + listed.stderr
    assert "A truck slower than this stands [m/s]" in help_.stdout and "[default: 0.1]" in help_.stdout
    assert (
        run(work, "-m", "fleetlog", "analyze", "idle", "recorded", "--below", "11", "-o", "x").returncode == 2
    )


def test_all_three_in_python(work: Path) -> None:
    done = run(work, "-c", blocks("python")[3])
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert (
        re.fullmatch(r"A stands \d+ % of the time, more than any other truck.", said[0])
        and said[-1] == "True"
    )


def test_a_broken_plug_in_is_named(work: Path) -> None:
    part = work / "installed" / "plantkit" / "idle.py"
    text = part.read_text()
    part.write_text("import nothing_of_the_kind\n")
    try:
        done = run(work, "-m", "fleetlog", "analyze", "idle", "recorded", "-o", "y")
    finally:
        part.write_text(text)
    assert done.returncode == 1 and "plantkit" in done.stderr and "Traceback" not in done.stderr


def test_added_analyses_are_offered_to_the_report(work: Path) -> None:
    code = (
        "import fleetlog; from fleetlog.report.report import added_results; "
        "d = fleetlog.read_logs('log.xyt', recording=False).dataset; "
        "print([(r.name, len(r.tables)) for r in added_results(d)]); "
        "page = fleetlog.report(d).page; print('of the time, more than any other truck' in page, 'Idle time</figcaption><svg' in page)"
    )
    done = run(work, "-c", code)
    assert done.stdout.splitlines() == ["[('idle', 1)]", "True True"], done.stderr
