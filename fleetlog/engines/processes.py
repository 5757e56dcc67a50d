"""Jobs on the cores of this machine: processes that are replaced when they die and end with their parent."""

import ctypes
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from fleetlog import interrupt
from fleetlog.engines.engine import AHEAD, Engine, J, Name, R, attempt, successes
from fleetlog.errors import DataError, FleetlogError

START = 0.5
"""Jobs that take less time than this in all are done here [s]."""
DEATHS = 3
"""A job whose worker died this often has failed."""
PATIENCE = 3.0
"""For a worker to clean up when it is told to end [s]."""
PR_SET_PDEATHSIG = 1

# A forked worker has all modules and compiled functions at once; elsewhere than on Linux, fork is not safe.
_context: Any = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")


class Processes(Engine):
    """``workers`` processes of this machine, started for every run; ``always`` however small the jobs are."""

    def __init__(self, workers: int, *, always: bool = False) -> None:
        self.workers, self.always = workers, always

    def pays(self, cost: float) -> bool:
        """Return whether the work is more than starting processes."""
        return self.workers > 1 and (self.always or cost > START)

    def run(self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J] = str) -> Generator[R, None, None]:
        """Yield the results; see :class:`~fleetlog.engines.engine.Engine`."""
        count = min(self.workers, len(jobs))
        if count < 2 or multiprocessing.current_process().daemon:
            return super().run(work, jobs, name)
        return successes(_run(work, jobs, name, count))


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    number: int | None = None
    """Of the job that it does."""


def _run(work: Callable[[J], R], jobs: Sequence[J], name: Name[J], count: int) -> Iterator[R | FleetlogError]:
    """Outcomes in the order of the jobs; at most ``AHEAD`` jobs per worker wait for their turn."""
    crew = [_start(work, name) for _ in range(count)]
    waiting, turn = list(range(len(jobs)))[::-1], 0
    early: dict[int, R | FleetlogError] = {}
    deaths = dict.fromkeys(range(len(jobs)), 0)
    try:
        while turn < len(jobs):
            for worker in crew:
                if worker.number is None and waiting and waiting[-1] < turn + AHEAD * count:
                    _give(worker, waiting.pop(), jobs)
            for k, number, outcome in _events(crew):
                if outcome is None:  # it died
                    crew[k] = _start(work, name)
                    deaths[number] += 1
                    if deaths[number] < DEATHS:
                        waiting.append(number)
                        continue
                    outcome = (_died(name(jobs[number])),)
                early[number] = outcome[0]
            while turn in early:
                yield early.pop(turn)
                turn += 1
    finally:
        _end(crew)


def _start(work: Callable[[J], R], name: Name[J]) -> _Worker:
    ours, theirs = _context.Pipe()
    process = _context.Process(target=_serve, args=(work, name, theirs, os.getpid()), daemon=True)
    with warnings.catch_warnings():  # of threads that a fork does not copy: a worker needs none of them
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _give(worker: _Worker, number: int, jobs: Sequence[Any]) -> None:
    worker.number = number
    with suppress(OSError):  # it died before: its end is seen with the next events
        worker.pipe.send((number, jobs[number]))


def _events(crew: list[_Worker]) -> list[tuple[int, int, tuple[Any] | None]]:
    """What happened next: worker, job, and its outcome, or None where the worker died at it."""
    busy = {w.pipe: k for k, w in enumerate(crew) if w.number is not None}
    out: list[tuple[int, int, tuple[Any] | None]] = []
    for pipe in wait(list(busy)):
        worker = crew[busy[pipe]]  # type: ignore[index]  # pipes only
        number, worker.number = worker.number, None
        assert number is not None
        try:
            _, outcome = worker.pipe.recv()
            out.append((busy[worker.pipe], number, (outcome,)))
        except (EOFError, OSError):
            worker.pipe.close()
            out.append((busy[worker.pipe], number, None))
    return out


def _died(name: str) -> DataError:
    return DataError(f"its worker died {DEATHS} times", where=name, do="free memory, or use fewer --workers")


def _end(crew: list[_Worker]) -> None:
    """Let the workers clean up what they are at, and end them."""
    for worker in crew:
        worker.process.terminate()
    for worker in crew:
        worker.process.join(PATIENCE)
        worker.process.kill()
        worker.process.join()
        worker.pipe.close()


def _serve(work: Callable[[Any], Any], name: Callable[[Any], str], pipe: Connection, parent: int) -> None:
    """Do jobs until the parent ends."""
    for number in interrupt.SIGNALS:  # a terminal sends them to all; the parent decides
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    if sys.platform == "linux":  # siblings hold the other end of the pipe, so it would not close
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            return
    while True:
        try:
            number, job = pipe.recv()
            outcome = attempt(work, job, name)
            pipe.send((number, outcome))
        except (EOFError, OSError):
            return
