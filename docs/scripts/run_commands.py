"""Run every fleetlog command of the pages and the README, in a folder that has the files they name.

python docs/scripts/run_commands.py            as printed (some simulate for hours: this takes a while)
python docs/scripts/run_commands.py --quick    simulations of ten minutes, one seed
python docs/scripts/run_commands.py --quick plan.md report.md      those of some pages

Prints each command with its time; exit status 1 if one fails.  A command that needs an extra of the package
which is not installed is said to be left out.
"""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import shlex
import shutil
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
COMMAND = re.compile(r"^(?: {4}|\$ |.*?`)(?:\.venv/bin/)?(fleetlog(?: +[^ #`\n]+)+)", re.MULTILINE)
NAMED = {
    "DATASET": "recorded", "RECORDED": "recorded", "SIMULATED": "simulated", "ANALYSIS": "density", "FILE.rrd": "both.rrd",
    "FORMAT": "csv", "FILE": "out.csv", "PATH": "recorded", "FOLDER": "density",
}  # fmt: skip
"""What stands for the names in capitals."""
ELSEWHERE = {
    "twizy": "a public data set",
    "mqtt://": "a broker of one's own",
    "tcp://": "a cluster of one's own",
    "s3://": "a bucket of one's own",
    "2026-03-03": "logs of another day",
    "VERB": "a synopsis",
    "LOG...": "a synopsis",
    "demo": "the demo alone runs for a minute; its steps are all here",
}
EXTRAS = {".xlsx": "xlsxwriter"}
"""Files that only an extra can write, and its package."""
RUNS = """run,kind,repeats,payload,height,length,speed,end_speed,grade,duration,energy,sigma
key on,idle,,,,,,,,600,41.6,
laden lifts,lift,20,2000,2,,,,,,422,
shuttle,stop_and_go,60,0,,20,3,,,,640,
"""
TASKS = "vehicle,from,to,payload,earliest\nany,dock-1,rack-1,800,0\nany,dock-2,rack-2,500,60\n"
PLAN = 'site = "site.toml"\ntruck = "truck.toml"\nduration = "5m"\nruns = 1\n[vary]\nvehicles = [2, 4]\n'


def pages() -> list[Path]:
    """Those whose commands stand for themselves: not tutorials, which are run in order by the tests."""
    skipped = {"reference", "decisions", "tutorials"}
    found = [p for p in sorted((ROOT / "docs").rglob("*.md")) if p.parent.name not in skipped]
    return [ROOT / "README.md", *(p for p in found if p.stem not in ("extend", "getting-started"))]


def commands(page: Path) -> Iterator[list[str]]:
    """The words of every command of a page after ``fleetlog``."""
    for found in COMMAND.finditer(page.read_text(encoding="utf-8")):
        text = re.sub(r"\[[^]]*\]|  .*", "", found[1])
        words = [NAMED.get(w, w) for w in shlex.split(text)[1:]]
        mentioned = len(words) < (3 if words[0] == "analyze" else 2)
        elsewhere = any(known in word for known in ELSEWHERE for word in words)
        if not mentioned and not elsewhere and "..." not in words:
            yield words


def prepare(run: object) -> None:
    """The files that the pages name, in the current folder."""
    import fleetlog

    fleetlog.demo(data="sample")
    for path in Path("sample").iterdir():
        if not path.name.startswith("."):
            path.rename(path.name)
    Path("runs.csv").write_text(RUNS)
    Path("tasks.csv").write_text(TASKS)
    Path("plan.toml").write_text(PLAN)
    Path("tariff.toml").write_text(indented("report", "currency"))
    Path("profile.toml").write_text(titled("tutorials/own-data", "profile.toml"))
    for week in ("week-10", "week-11"):
        fleetlog.read_logs(
            f"messy/{week}.csv.gz", profile="profile.toml", site="site.toml", recording=False, output=week
        )
    Path("log.jsonl").write_bytes(gzip.decompress(Path("logs/T7_vda5050.jsonl.gz").read_bytes()))
    fleetlog.calibrate("runs.csv", truck="counterbalance-2.5t", output="plant.toml")
    site = "site.toml"
    recorded = fleetlog.read_logs("logs", site=site, output="recorded")
    fleetlog.simulate(like=recorded, truck="truck.toml", duration="10m", output="simulated")
    fleetlog.diagnose("recorded", truck="truck.toml", channels=("battery_power",), output="diagnosis")
    fleetlog.analyze.density(recorded, output="density")
    fleetlog.view("recorded", beside="simulated", save="both.rrd")
    fleetlog.export(recorded, to="sumo-fcd", output="driven.fcd.xml")


def titled(page: str, title: str) -> str:
    """A file that a page shows under its name."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    return text.split(f'title="{title}"\n')[1].split("```")[0]


def indented(page: str, first: str) -> str:
    """The indented block of a page that begins with a word."""
    lines = (
        (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8").split(f"    {first} ")[1].split("\n\n")[0]
    )
    return textwrap.dedent(f"    {first} {lines}")


def quick(words: list[str]) -> list[str]:
    """The command with a short simulation of few variants."""
    if words[0] != "simulate":
        return words
    short = {"--duration": "10m", "--runs": "1"}
    out = [short.get(before, word) for before, word in zip(["", *words], words, strict=False)]
    return (
        out
        if "--duration" in out or "--experiment" in out or "--same-mission" in out
        else [*out, "--duration", "10m"]
    )


MADE = ("recorded", "simulated", "diagnosis", "density")
"""What every page finds, whatever the pages before it have put in its place."""


def run(words: list[str]) -> tuple[bool, str]:
    """Whether a command ends well, and what it says; outputs of an earlier one are replaced."""
    from click.testing import CliRunner

    from fleetlog.cli.main import cli

    for flag in ("-o", "--save", "--screenshot"):
        if flag in words and "--overwrite" not in words and "--append" not in words:
            words = [*words, "--overwrite"]
    done = CliRunner().invoke(cli, words, standalone_mode=False)
    good = done.exception is None and done.return_value in (None, 0, 3)
    return good, f"{done.exception or done.return_value}"


def restore(kept: Path) -> None:
    """Put back what was made for all pages."""
    for name in MADE:
        shutil.rmtree(name, ignore_errors=True)
        shutil.copytree(kept / name, name)


def main(short: bool, names: list[str]) -> int:
    """Run those of some pages, or of all; return how many failed."""
    from fleetlog.view import viewer

    viewer.show = lambda rrd: None
    failed, seen = 0, set()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        prepare(run)
        for name in MADE:
            shutil.copytree(name, Path("kept") / name)
        for page in (p for p in pages() if not names or p.name in names):
            restore(Path("kept"))
            for words in commands(page):
                words = quick(words) if short else words
                shows = words[0] in ("info", "view") or "--dry-run" in words
                # Without an output, or a file that is there to be shown, it is a mention, not a command.
                if tuple(words) in seen or not ("-o" in words or (shows and any(map(os.path.exists, words)))):
                    continue
                seen.add(tuple(words))
                lacks = {
                    p for end, p in EXTRAS.items() if any(w.endswith(end) for w in words) and not find_spec(p)
                }
                if lacks:
                    print(f"{page.name}: fleetlog {shlex.join(words)}: left out, needs {', '.join(lacks)}")
                    continue
                begun = time.monotonic()
                good, why = run(words)
                failed += not good
                state = "done" if good else f"FAILED ({why})"
                took = time.monotonic() - begun
                print(f"{page.name}: fleetlog {shlex.join(words)}: {state}, {took:.1f} s", flush=True)
    print(f"{len(seen)} commands, {failed} failed")
    return failed


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    given = sys.argv[1:]
    sys.exit(bool(main("--quick" in given, [name for name in given if name != "--quick"])))
