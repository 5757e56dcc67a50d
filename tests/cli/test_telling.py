"""How commands speak: lines that break between words, steps with times, completion, one status for one mistake."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from fleetlog.cli.main import cli, wrapped


def test_sentences_break_between_words_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    line = "  " + "a-long-name " * 12 + "end."
    assert wrapped(line) == line
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    broken = wrapped(line).splitlines()
    assert max(map(len, broken)) <= 80 and len(broken) == 2
    assert " ".join(broken).split() == line.split() and broken[1].startswith("    ")
    table = "  vehicle_id  timestamp" + " " * 80 + "x"
    assert wrapped(table) == table


def test_completion_of_verbs_analyses_and_options() -> None:
    def complete(words: str) -> list[str]:
        said = subprocess.run(
            [sys.executable, "-c", "from fleetlog.cli.main import entry; import sys; sys.argv[0] = 'fleetlog'; entry()"],
            capture_output=True, text=True, env={
                **os.environ, "_FLEETLOG_COMPLETE": "bash_complete", "COMP_WORDS": words,
                "COMP_CWORD": str(len(words.split(" ")) - 1),
            },
        )  # fmt: skip
        return [line.split(",")[-1] for line in said.stdout.splitlines()]

    assert complete("fleetlog ana") == ["analyze"]
    assert complete("fleetlog analyze de") == ["density"]
    assert "--threshold" in complete("fleetlog analyze density x --thr")
    assert complete("fleetlog diagnose x --holdout ve") == ["vehicles"]


def _more(terminal: int) -> str:
    """What a terminal still has to say; nothing once its other side is closed."""
    try:
        return os.read(terminal, 4096).decode(errors="replace")
    except OSError:
        return ""


def test_a_bar_ends_with_a_line_and_steps_have_times(project_root: Path, tmp_path: Path) -> None:
    log = project_root / "sample_data" / "logs" / "T8.nmea.gz"
    words = [sys.executable, "-m", "fleetlog", "import", str(log), "--no-recording", "-o"]
    main, side = pty.openpty()
    with subprocess.Popen([*words, str(tmp_path / "a")], stdout=subprocess.DEVNULL, stderr=side) as run:
        os.close(side)
        said = "".join(iter(lambda: _more(main), ""))  # A terminal that nobody reads would stop the run.
    # Whatever comes next stands on a line of its own: the last one ended, or the bar was wiped off it.
    assert run.returncode == 3 and said.endswith(("\n", "\r\x1b[1A\x1b[2K"))
    spoken = subprocess.run([*words, str(tmp_path / "b"), "-v"], capture_output=True, text=True)
    assert " s  reading T8.nmea.gz" in spoken.stderr and spoken.stdout.endswith(
        f"recorded dataset: {tmp_path / 'b'}\n"
    )


MISSING = [
    ["import", "nope", "-o", "o"], ["info", "nope"], ["view", "nope"], ["diagnose", "nope", "--truck", "counterbalance-2.5t", "-o", "o"],
    ["export", "nope", "--to", "csv", "-o", "o"], ["calibrate", "nope", "--truck", "counterbalance-2.5t", "-o", "o"],
    ["simulate", "--site", "nope", "--truck", "counterbalance-2.5t", "-o", "o"], ["simulate", "--like", "nope", "--truck", "nope", "-o", "o"],
    *[["analyze", name, "nope", "-o", "o"] for name in ("trips", "stops", "density", "heatmap", "chargers")],
]  # fmt: skip


@pytest.mark.parametrize("words", MISSING, ids=lambda w: " ".join(w[:2]))
def test_a_missing_file_is_one_mistake(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fleetlog.errors import InputError

    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(cli, words)
    assert isinstance(done.exception, InputError) and "nope" in done.exception.line()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "near"),
    [(["analise"], "analyze"), (["analyze", "densty"], "density"), (["info", "--jsn"], "--json")],
)
def test_wrong_names_get_a_suggestion(words: list[str], near: str) -> None:
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 2 and near in done.output


@pytest.mark.parametrize(
    ("word", "meant"),
    [("slope", "grade"), ("heater", "auxiliary_load"), ("drag", "aerodynamic_drag"), ("grad", "grade")],
)
def test_a_word_for_a_term_suggests_the_term(word: str, meant: str) -> None:
    from fleetlog.discovery.diagnose import check
    from fleetlog.errors import ArgumentError

    with pytest.raises(ArgumentError, match=f"did you mean .*'{meant}'"):
        check(terms=[word])
