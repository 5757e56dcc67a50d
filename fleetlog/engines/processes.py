"""Jobs on the cores of this machine: processes that are replaced when they die and end with their parent."""

import ctypes
import faulthandler
import multiprocessing
import os
import pickle
import signal
import sys
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from fleetlog import interrupt
from fleetlog.engines import AHEAD, Engine, Failure, J, Name, Outcomes, R, Tasks, attempt
from fleetlog.errors import DataError

START = 0.5  # Jobs that take less time than this in all are done here [s]
DEATHS = 3  # A job whose worker died this often has failed
PATIENCE = 3.0  # For a worker to clean up when it is told to end [s]
PR_SET_PDEATHSIG = 1

# A forked worker has all modules and compiled functions at once; elsewhere than on Linux, fork is not safe.
_context: Any = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")


class Processes(Engine):
    """``workers`` processes of this machine, started for every run; ``always`` however small the jobs are."""

    def __init__(self, workers: int, *, always: bool = False) -> None:
        self.workers, self.always = workers, always
        self.engaged = 0  # Workers that are at jobs of runs that wait for what is done beside them

    def pays(self, cost: float) -> bool:
        """Return whether the work is more than starting processes; not within a worker."""
        worker = multiprocessing.current_process().daemon
        return self.workers > 1 and (self.always or cost > START) and not worker

    def _done(self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J], beside: Tasks) -> Outcomes[R]:
        """As the engine here gives them; at most ``AHEAD`` jobs per worker wait for their turn."""
        count = min(max(1, self.workers - self.engaged), len(jobs))
        if min(self.workers, count + len(beside)) < 2:
            return super()._done(work, jobs, name, beside)
        ahead, self.ahead = self.ahead, ()
        return self._run(work, jobs, name, count, [*beside, *ahead])

    def _run(
        self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J], count: int,
        beside: list[Callable[[], object]],
    ) -> Outcomes[R]:  # fmt: skip
        crew = dict(_start(work, name) for _ in range(count))
        busy: dict[Connection, int] = {}
        waiting, turn = list(range(len(jobs)))[::-1], 0
        early: dict[int, R | Failure] = {}
        deaths = Counter[int]()
        try:
            while turn < len(jobs):
                for pipe in [p for p in crew if p not in busy]:
                    if waiting and waiting[-1] < turn + AHEAD * count:
                        busy[pipe] = waiting.pop()
                        with suppress(OSError):  # it died before: its end is seen below
                            pipe.send(jobs[busy[pipe]])
                if not (ready := wait(list(busy), 0 if beside else None)):
                    with self._beside(busy):
                        beside.pop(0)()
                for pipe in [p for p in crew if p in ready]:
                    number = busy.pop(pipe)
                    try:
                        early[number] = pipe.recv()
                    except (EOFError, OSError):  # it died
                        dead = crew.pop(pipe)
                        _end({pipe: dead})
                        crew.update([_start(work, name)])
                        deaths[number] += 1
                        waiting.append(number)
                        if deaths[number] == DEATHS:
                            what = f"its worker died {DEATHS} times (exit status {dead.exitcode})"
                            do = "free memory, or use fewer --workers"  # the system kills what takes too much
                            do = do if dead.exitcode == -signal.SIGKILL else "please report it"
                            early[waiting.pop()] = DataError(what, where=name(jobs[number]), do=do)
                while turn in early:
                    with self._beside(busy):
                        yield early.pop(turn)
                    turn += 1
            for task in beside:
                task()
        finally:
            _end(crew)

    @contextmanager
    def _beside(self, busy: Sized) -> Iterator[None]:
        """Leave busy workers their cores: other runs of this process do with fewer."""
        count = len(busy)
        self.engaged += count
        try:
            yield
        finally:
            self.engaged -= count

    def stream(self, work: Callable[[J], R], jobs: Iterator[J], cost: float) -> Generator[R, None, None]:
        """By threads of this process, ahead of who takes the results; one more draws the jobs."""
        if not self.pays(cost):
            yield from super().stream(work, jobs, cost)
            return

        threads = min(self.workers, AHEAD)  # more would wait for who takes the results
        drawing, pool = ThreadPoolExecutor(1), ThreadPoolExecutor(threads)

        def ahead() -> Future[R]:
            return pool.submit(lambda job: work(job.result()), drawing.submit(next, jobs))

        waiting = deque(ahead() for _ in range(threads))
        try:
            with suppress(StopIteration):
                while True:
                    waiting.append(ahead())
                    yield waiting.popleft().result()
        finally:
            drawing.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)


def _start(work: Callable[[J], R], name: Name[J]) -> tuple[Connection, BaseProcess]:
    ours, theirs = _context.Pipe()
    process = _context.Process(target=_serve, args=(work, name, theirs, os.getpid()), daemon=True)
    with interrupt.later(), warnings.catch_warnings():
        # Of threads that a fork does not copy: a worker needs none of them.
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    theirs.close()
    return ours, process


def _end(crew: dict[Connection, BaseProcess]) -> None:
    """Let the workers clean up what they are at, and end them."""
    for process in crew.values():
        process.terminate()
    for pipe, process in crew.items():
        process.join(PATIENCE)
        process.kill()
        process.join()
        pipe.close()


def _serve(work: Callable[[Any], Any], name: Callable[[Any], str], pipe: Connection, parent: int) -> None:
    """Do jobs until the parent ends."""
    interrupt.obey()
    faulthandler.enable(2)  # where compiled code died is worth a report
    if sys.platform == "linux":  # siblings hold the other end of the pipe, so it would not close
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            return
    # The largest block that went back sets what glibc keeps: without it, arrays of some 100,000 rows would go
    # back to the system each time, and their pages come anew.
    bytearray(30 << 20)  # it counts up to 32 MiB
    with suppress(EOFError, OSError):
        while True:
            # The newest protocol copies the data of arrays once less than the pipe's own.
            pipe.send_bytes(pickle.dumps(attempt(work, pipe.recv(), name), pickle.HIGHEST_PROTOCOL))
