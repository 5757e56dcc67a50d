"""The documentation does what it says: tutorials run as printed in an empty folder, every other command exists."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from fleetlog.cli.main import cli

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TUTORIALS = [DOCS / "getting-started.md", *sorted((DOCS / "tutorials").glob("*.md"))]
BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```', re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^(?: {4}|\$ |.*?`)(?:\.venv/bin/)?(fleetlog(?: +[^ #`\n]+)+)", re.MULTILINE)


def run(words: list[str]) -> str:
    """One command; what a viewer's window would show is not opened."""
    done = CliRunner().invoke(cli, words, standalone_mode=False)
    assert done.exception is None and done.return_value in (None, 0, 3), (words, done.exception, done.stderr)
    return done.output


SLOW = {"getting-started", "simulator"}
"""They simulate and diagnose, which takes minutes on a busy machine."""


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.slow] if p.stem in SLOW else []) for p in TUTORIALS],
)
def test_tutorials_run_as_printed(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fleetlog.view import viewer

    shown: list[Path] = []
    monkeypatch.setattr(viewer, "show", shown.append)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    count = 0
    for kind, title, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if title:
            Path(title).write_text(text, encoding="utf-8")
        elif kind == "console":
            for line in text.splitlines():
                assert line.startswith("$ fleetlog "), line
                run(shlex.split(line)[2:])
                count += 1
        elif kind == "python":
            exec(compile(text, str(page), "exec"), names)
            count += 1
    assert count > 5
    assert all(p.stat().st_size > 1000 for p in shown)


def commands() -> Iterator[tuple[str, str]]:
    """Every command line of the pages and the README, with the page."""
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        if page.parent.name in ("reference", "decisions") or page.stem == "extend":
            continue  # generated, history, and test_plugins.py
        for found in COMMAND.finditer(page.read_text(encoding="utf-8")):
            yield page.name, found[1].strip()


def test_every_command_of_the_pages_is_one() -> None:
    seen = 0
    for page, text in commands():
        words = [w for w in shlex.split(text)[1:] if w != "..."]
        command: click.Command = cli
        context = click.Context(cli, info_name="fleetlog")
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            if words[0].isupper():
                break  # a synopsis: fleetlog VERB --help
            found = command.get_command(context, words[0])
            assert found is not None, (page, text)
            command, words = found, words[1:]
        spelled = {s for p in command.params for s in (*p.opts, *p.secondary_opts)} | {
            "-h",
            "--help",
            "-V",
            "--version",
        }
        for word in (w.strip("[]") for w in words):
            if re.match(r"-{1,2}[a-z]", word):
                assert word in spelled, (page, text, word)
        seen += 1
    assert seen > 60


def test_help_breaks_no_word_at_80_columns() -> None:
    def texts(command: click.Command, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str, str]]:
        pages = [
            command.get_help(
                click.Context(command, info_name="fleetlog", max_content_width=w, terminal_width=w)
            )
            for w in (80, 1000)
        ]
        yield path, pages[0], pages[1]
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                child = command.get_command(context, name)
                assert child is not None
                yield from texts(child, (*path, name))

    for path, narrow, wide in texts(cli, ()):
        assert narrow.split() == wide.split(), path
        assert max(map(len, narrow.splitlines())) <= 80, path


OLD_WORDS = ("ledger", "kept back", "honest", "standstill", "polish", "aloud", "doubt", "nobody")


def test_help_uses_the_words_of_the_glossary() -> None:
    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8").lower()
    assert not [w for w in OLD_WORDS if w in text]
    rows = re.findall(r"^\| ([^|]+) \|", (DOCS / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE)[2:]
    assert rows == sorted(rows, key=str.lower) and len(rows) > 35
