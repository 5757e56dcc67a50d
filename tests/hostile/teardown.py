"""Tear down every verb: what is left of an output when a run is killed, interrupted, raced, or out of disk.

    python tests/hostile/teardown.py [--rounds 10] [--verbs import,export] [--trials kill,term]

prints a table: a row a verb, a column a trial, ``held/tried`` in each cell, and every breach below it.  The law is
one: whatever happens, the place of an output holds nothing, the older output or the newer one, whole, and the status
says which.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_data"
TRUCK, SITE = "plant/truck.toml", "plant/site.toml"
POWER = ["--channels", "battery_power"]
ENV = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "FLEETLOG_DEBUG": ""}
FORMATS = ("csv", "geojson", "gpx", "kitti", "mcap", "parquet", "sumo-fcd", "sumo-net", "tum")
ONE = {"kitti": ["--vehicle", "T1"], "tum": ["--vehicle", "T1"]}
"""Formats of one vehicle."""
WHERE = {"kitti": "OUT.d/poses.kitti"}
"""Poses have times.txt beside them, in a folder of their own."""
LIMIT = 900.0
"""Longest a run may take [s]; one that takes longer hangs."""

VERBS: dict[str, list[str]] = {
    "import": ["import", "log.csv", "--site", SITE, "-o", "OUT"],
    "simulate": ["simulate", "--site", SITE, "--truck", TRUCK, "--vehicles", "2", "--duration", "60s", "-o", "OUT"],
    "simulate-like": ["simulate", "--like", "recorded", "--truck", TRUCK, "--duration", "60s", "-o", "OUT"],
    "same-mission": ["simulate", "--like", "recorded", "--same-mission", "--truck", TRUCK, "-o", "OUT"],
    "trips": ["analyze", "trips", "recorded", "-o", "OUT"],
    "stops": ["analyze", "stops", "recorded", "-o", "OUT"],
    "energy": ["analyze", "energy", "recorded", "--truck", TRUCK, "-o", "OUT"],
    "density": ["analyze", "density", "recorded", "-o", "OUT"],
    "heatmap": ["analyze", "heatmap", "recorded", "-o", "OUT"],
    "chargers": ["analyze", "chargers", "recorded", "-k", "2", "-o", "OUT"],
    "calibrate": ["calibrate", "recorded", "--truck", TRUCK, "-o", "OUT.toml"],
    "diagnose": ["diagnose", "recorded", "--truck", TRUCK, *POWER, "-o", "OUT"],
    "against": ["diagnose", "recorded", "--truck", TRUCK, "--against", "simulated", *POWER, "-o", "OUT"],
    **{
        f"export-{kind}": ["export", "recorded", "--to", kind, *ONE.get(kind, []), "-o", WHERE.get(kind, f"OUT.{kind}")]
        for kind in FORMATS
    },
    "tasks": ["simulate", "--site", SITE, "--truck", TRUCK, "--tasks", "tasks.csv", "--vehicles", "2", "--duration", "60s", "-o", "OUT"],
    "cycle": ["simulate", "--cycle", "vdi2198", "--truck", TRUCK, "--duration", "60s", "-o", "OUT"],
    "experiment": ["simulate", "--site", SITE, "--truck", TRUCK, "--vehicles", "2,3", "--workers", "2", "--duration", "60s", "-o", "OUT"],
    "view": ["view", "recorded", "--beside", "simulated", "--save", "OUT.rrd"],
    "screenshot": ["view", "simulated", "--screenshot", "OUT.png"],
    "report": ["report", "recorded", "simulated", "-o", "OUT.html"],
    "learn": ["learn", "recorded", "-o", "OUT"],
    "demo": ["demo", "-o", "OUT"],
}  # fmt: skip
DEMO = """
from pathlib import Path
import fleetlog.verbs.demo as demo
from fleetlog.cli.main import entry
folder, steps, short = Path("sample").resolve(), demo.steps, {"vehicles": 2, "duration": "60s"}
demo.sample_folder = lambda: folder
demo.steps = lambda sample: ((*s, o | short if "duration" in o else o) for *s, o in steps(sample))
entry()
"""
"""The demo on the logs of two trucks, with a short simulation: a fifth of the time."""
TASKS = "dock-1,rack-1,500,0\ndock-2,rack-2,700,10\n"
READS: dict[str, list[str]] = {
    "info": ["info", "recorded"], "info-log": ["info", "log.csv"], "dry-run": ["import", "log.csv", "--dry-run"],
}  # fmt: skip
"""Verbs that write nothing."""


@dataclass(frozen=True)
class Done:
    """One finished run."""

    status: int
    out: str
    err: str
    seconds: float


@dataclass
class Case:
    """A verb in a folder of its own, and what its output is when it is whole."""

    verb: str
    folder: Path
    whole: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    largest: int = 0

    def argv(self, *more: str, out: str = "out") -> list[str]:
        words = [w.replace("OUT", out) for w in (VERBS | READS)[self.verb]]
        program = ["-c", DEMO] if self.verb == "demo" else ["-m", "fleetlog"]
        return [sys.executable, *program, *words, *more]

    def target(self, out: str = "out") -> Path:
        return self.folder / self.argv(out=out)[-1]

    def run(self, *more: str, out: str = "out", **how: object) -> Done:
        return run(self.argv(*more, out=out), self.folder, **how)  # type: ignore[arg-type]

    def left(self) -> list[str]:
        """Scratch that is still there."""
        return [p.name for p in self.folder.rglob(".*.partial")]

    def state(self, out: str = "out") -> str:
        """``nothing``, ``whole`` or what is wrong with the output."""
        found = contents(self.target(out))
        if not found:
            return "nothing"
        wrong = sorted(n for n in found.keys() | self.whole.keys() if found.get(n) != self.whole.get(n))
        return f"broken: {wrong[:3]}" if wrong else "whole"


def run(
    argv: list[str], folder: Path, *, after: Callable[[subprocess.Popen[bytes]], None] | None = None,
    limit: int | None = None, out: int | None = None, err: int | None = None, closed: tuple[int, ...] = (),
) -> Done:  # fmt: skip
    """Run a command line; ``after`` may do something to it while it runs."""

    def prepare() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        for number in closed:
            os.close(number)

    begin = time.monotonic()
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as told:
        process = subprocess.Popen(
            argv, cwd=folder, env=ENV, stdin=subprocess.DEVNULL, stdout=said if out is None else out,
            stderr=told if err is None else err, preexec_fn=prepare,
        )  # fmt: skip
        try:
            if after is not None:
                after(process)
            status = process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            status = process.wait() or -9
        texts = []
        for stream in (said, told):
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace"))
    return Done(status, *texts, time.monotonic() - begin)


def contents(path: Path) -> dict[str, str]:
    """The digest of every file of an output; of a recording, whose bytes differ, whether it ends well."""
    from fleetlog.view.stream import check_whole

    found = {}
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.suffix == ".rrd" and file.is_file():
            check_whole(file)
            found[str(file.relative_to(path))] = "a whole recording"
        elif file.is_file():
            found[str(file.relative_to(path))] = hashlib.sha256(_without_command(file)).hexdigest()
    return found


def _without_command(file: Path) -> bytes:
    """The bytes of a file; of a dataset's description all but the command line."""
    if file.name != "dataset.json":
        return file.read_bytes()
    description = json.loads(file.read_bytes())
    description["provenance"].pop("command", None)
    return json.dumps(description, sort_keys=True).encode()


def prepare(folder: Path) -> None:
    """Inputs for all verbs: a log, a recorded and a simulated dataset of four trucks and three minutes."""
    shutil.copytree(SAMPLE, folder / "plant")
    fleet = ["--vehicles", "4", "--duration", "180s", "--no-recording"]
    for words in (
        ["simulate", "--site", SITE, "--truck", TRUCK, *fleet, "-o", "simulated"],
        ["export", "simulated", "--to", "csv", "-o", "log.csv"],
        ["import", "log.csv", "--site", SITE, "-o", "recorded", "--no-recording"],
    ):
        done = run([sys.executable, "-m", "fleetlog", *words], folder)
        assert done.status == 0, done.err
    (folder / "tasks.csv").write_text("from,to,payload,earliest\n" + TASKS)
    several = shutil.ignore_patterns("fleet.csv.gz", "other_maker.csv.gz", "T8*", "messy", "*.py")
    shutil.copytree(SAMPLE, folder / "sample", ignore=several)


def reading(verb: str, inputs: Path, folder: Path, rounds: int, rng: random.Random) -> list[str]:
    """However a run of a verb that only reads ends, nothing is written and nothing has changed."""
    shutil.copytree(inputs, folder, dirs_exist_ok=True)
    case, breaches = Case(verb, folder), []
    before, first = contents(folder), case.run()
    for which in (None, signal.SIGKILL, signal.SIGTERM, signal.SIGINT) * rounds:
        if which is None:
            done, wanted = case.run(closed=(1, 2)), {first.status}
        else:
            strike = partial(_later, moment=rng.uniform(0.0, 0.9) * first.seconds, which=which, ready=True)
            done, wanted = case.run(after=strike), {first.status, 130, -9 * (which == signal.SIGKILL)}
        if done.status not in wanted or contents(folder) != before or case.left():
            breaches.append(f"{verb}, {which}: status {done.status} {done.err[-200:]}")
    return breaches


def case_of(verb: str, inputs: Path, folder: Path) -> Case:
    """A verb's case with a first output in its place; run twice: what differs by itself would count as broken."""
    shutil.copytree(inputs, folder, dirs_exist_ok=True)
    case = Case(verb, folder)
    first = case.run()
    assert first.status in (0, 3), (verb, first.err)
    case.whole, case.seconds = contents(case.target()), first.seconds
    again = case.run("--overwrite")
    assert again.status in (0, 3), (verb, again.err)
    same = contents(case.target())
    varying = {n for n in case.whole if case.whole[n] != same.get(n)}
    assert not varying, (verb, varying)
    files = case.target().rglob("*") if case.target().is_dir() else [case.target()]
    case.largest = max(p.stat().st_size for p in files if p.is_file())
    return case


Trial = Callable[[Case, random.Random], str | None]
"""Tries one thing on a case with an older output in its place; what broke, or None."""


def kill(case: Case, rng: random.Random) -> str | None:
    """Kill -9 at a random moment: the older or the newer output is there, the next run works and cleans up."""
    moment = rng.uniform(0.3, 1.05) * case.seconds
    case.run("--overwrite", after=lambda p: _later(p, moment, signal.SIGKILL))
    if (state := case.state()) != "whole":
        return f"killed after {moment:.2f} s: {state}"
    again = case.run("--overwrite")
    if again.status not in (0, 3) or case.state() != "whole" or case.left():
        return f"run after a kill: {again.status} {again.err[-200:]} {case.left()}"
    return None


def term(case: Case, rng: random.Random) -> str | None:
    """SIGTERM or SIGINT at a random moment: 130 and nothing new, or done."""
    moment, which = rng.uniform(0.0, 0.9) * case.seconds, rng.choice([signal.SIGTERM, signal.SIGINT])
    done = case.run(out="new", after=lambda p: _later(p, moment, which, ready=True))
    state = case.state("new")
    remove(case.target("new"))
    good = (done.status == 130 and state == "nothing") or (done.status in (0, 3) and state == "whole")
    if not good or case.left() or "Traceback" in done.err:
        return f"{which.name} after {moment:.2f} s: status {done.status}, {state}, {case.left()}, {done.err[-200:]}"
    return None


def _later(
    process: subprocess.Popen[bytes], moment: float, which: signal.Signals, ready: bool = False
) -> None:
    """Send a signal at a moment; ``ready``: counted from when the run has its handlers."""
    status = Path(f"/proc/{process.pid}/status")
    while ready and process.poll() is None and status.exists():
        caught = next(line for line in status.read_text().splitlines() if line.startswith("SigCgt"))
        ready = not int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1
    try:
        process.wait(moment)
    except subprocess.TimeoutExpired:
        process.send_signal(which)


def file_size(case: Case, rng: random.Random) -> str | None:
    """``ulimit -f`` below the largest file: one line, status 1, the older output stays."""
    limit = int(case.largest * rng.uniform(0.02, 0.95))
    return _refused(case, case.run("--overwrite", limit=limit), f"ulimit -f {limit} bytes")


def _refused(case: Case, done: Done, what: str, out: str = "out") -> str | None:
    state = case.state(out)
    lines = [line for line in done.err.splitlines() if line.startswith("fleetlog: ")]
    if done.status != 1 or len(lines) != 1 or "a fault in fleetlog" in done.err or case.left():
        return f"{what}: status {done.status}, {state}, {case.left()}, {done.err[-300:]!r}"
    return None if state in ("whole", "nothing") else f"{what}: {state}"


def full_disk(case: Case, rng: random.Random) -> str | None:
    """A file system too small for the output: one line, status 1, nothing there."""
    size = sum(p.stat().st_size for p in case.target().rglob("*") if p.is_file()) or case.largest
    small = case.folder / "small"
    with mounted(small, f"size={max(int(size * rng.uniform(0.1, 0.8)), 8192)}"):
        if size < 20_000:  # less than the pages that a file system has at least
            with contextlib.suppress(OSError):
                (small / "filler").write_bytes(bytes(8192))
        done = case.run(out="small/new")
        found = [p for p in small.rglob("*") if not p.is_dir() and p.name != "filler"]
        broken = _refused(case, done, "full disk", "small/new")
        return broken or (f"full disk: {found} is left" if found else None)


def read_only(case: Case, _: random.Random) -> str | None:
    """A file system that cannot be written: one line, status 1."""
    with mounted(case.folder / "small", "ro,size=64k"):
        return _refused(case, case.run(out="small/new"), "read-only", "small/new")


def race(case: Case, rng: random.Random) -> str | None:
    """Two runs to one place: one is done, the other fails with one line."""
    both: list[Done] = []
    wait = rng.uniform(0.0, 0.3)

    def second(_: subprocess.Popen[bytes]) -> None:
        time.sleep(wait)
        both.append(case.run(out="new"))

    both.append(case.run(out="new", after=second))
    state = case.state("new")
    remove(case.target("new"))
    lost = [d for d in both if d.status == 1]
    won = [d for d in both if d.status in (0, 3)]
    said = len(lost) == 1 and ("another run" in lost[0].err or "already there" in lost[0].err)
    if state != "whole" or len(won) != 1 or not said or case.left():
        return f"race: {[d.status for d in both]}, {state}, {[d.err[-150:] for d in both]}, {case.left()}"
    return None


def streams(case: Case, rng: random.Random) -> str | None:
    """Closed standard streams, and a standard error that takes nothing, change nothing."""
    closed = rng.choice([(0,), (1,), (2,), (1, 2), (0, 1, 2)])
    done = case.run("--overwrite", closed=closed)
    if done.status not in (0, 3) or case.state() != "whole" or case.left():
        return f"closed {closed}: status {done.status}, {case.state()}, {done.err[-200:]}"
    with Path("/dev/full").open("wb") as full:
        done = case.run("--overwrite", err=full.fileno())
    if done.status not in (0, 3) or case.state() != "whole":
        return f"full standard error: status {done.status}, {case.state()}"
    return None


def own_input(case: Case, _: random.Random) -> str | None:
    """Every path that a run reads as its output: refused, and the input is as it was."""
    words = case.argv()
    for source in [w for w in words[3:] if (case.folder / w).exists() and not w.startswith("out")]:
        before = contents(case.folder / source)
        inside = ("", "/dataset.json", "/trajectories", "/new") if (case.folder / source).is_dir() else ("",)
        for name in [source + part for part in inside]:
            done = run([*words[:-1], name, "--overwrite"], case.folder)
            if done.status != 1 or contents(case.folder / source) != before or case.left():
                return f"-o {name}: status {done.status} {done.err[-200:]}"
    return None


TRIALS: dict[str, Trial] = {
    "kill": kill, "term": term, "ulimit": file_size, "disk": full_disk, "read-only": read_only, "race": race,
    "streams": streams, "input": own_input,
}  # fmt: skip
ONCE = {"read-only", "input"}
MOUNTS = {"disk", "read-only"}


def can_mount() -> bool:
    """Whether this machine lets us mount a small file system."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            with mounted(Path(folder) / "m", "size=64k"):
                return True
        except (OSError, subprocess.CalledProcessError):
            return False


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[None]:
    """A small file system in memory."""
    folder.mkdir(exist_ok=True)
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True, capture_output=True
    )
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)
        folder.rmdir()


def remove(target: Path) -> None:
    """Take an output away, and its mark; that of KITTI poses has their times beside it."""
    if target.suffix == ".kitti":
        remove(target.with_name("times.txt"))
    if target.is_dir():
        shutil.rmtree(target)
    target.with_name(f".{target.name}.fleetlog").unlink(missing_ok=True)
    target.unlink(missing_ok=True)


def tear(
    verb: str, inputs: Path, folder: Path, rounds: int, trials: list[str], seed: int
) -> tuple[dict[str, str], list[str]]:
    """All trials on one verb: ``held/tried`` by trial, and the breaches."""
    case, rng = case_of(verb, inputs, folder), random.Random(f"{seed} {verb}")
    row, breaches = {}, []
    for name in trials:
        tried = 1 if name in ONCE else rounds
        broken = [b for _ in range(tried) if (b := TRIALS[name](case, rng)) is not None]
        row[name] = f"{tried - len(broken)}/{tried}"
        breaches += [f"{verb}, {name}: {b}" for b in broken]
    return row, breaches


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--verbs", default=",".join(VERBS | READS))
    parser.add_argument("--trials", default=",".join(TRIALS))
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    trials = [t for t in given.trials.split(",") if t not in MOUNTS or can_mount()]
    for name in set(given.trials.split(",")) - set(trials):
        print(f"{name}: skipped, this machine lets nothing be mounted")
    print("| verb | " + " | ".join(trials) + " |\n|" + " --- |" * (len(trials) + 1))
    every = []
    with tempfile.TemporaryDirectory() as scratch:
        inputs = Path(scratch) / "inputs"
        inputs.mkdir()
        prepare(inputs)
        for verb in given.verbs.split(","):
            if verb in READS:
                breaches = reading(
                    verb, inputs, Path(scratch) / verb, given.rounds, random.Random(given.seed)
                )
                print(f"{verb}: {4 * given.rounds - len(breaches)}/{4 * given.rounds}", *breaches, flush=True)
                every += breaches
                continue
            row, breaches = tear(verb, inputs, Path(scratch) / verb, given.rounds, trials, given.seed)
            print(f"| {verb} | " + " | ".join(row[t] for t in trials) + " |", flush=True)
            every += breaches
            print(*(f"    {b}" for b in breaches), sep="\n", end="", flush=True)
    print(f"\n{len(every)} breaches")
    return 1 if every else 0


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
