"""Where jobs run: here, on all cores, or on a Dask cluster.  Nothing else in fleetlog knows.

An engine does jobs, in any order, and gives their results in the order of the jobs."""

import os
import pickle
import re
from collections import ChainMap
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar, TypeAlias, TypeVar

from fleetlog.errors import DataError, FleetlogError, InputError, fault
from fleetlog.registry import extra

J = TypeVar("J")
R = TypeVar("R")
Name: TypeAlias = Callable[[J], str]
Failure: TypeAlias = FleetlogError | OSError
Outcomes: TypeAlias = Iterator[R | Failure]
Tasks: TypeAlias = Sequence[Callable[[], object]]
AHEAD = 4  # Jobs per worker that may be done before their turn; their results wait in memory
PER_WORKER = 1 << 30  # Memory that is reckoned for a worker by default [bytes]


class Engine:
    """Does jobs; function, jobs and results must be picklable.  This one does them here, in turn."""

    workers = 1  # Jobs that run at the same time
    ahead: Tasks = ()  # What will be needed here: who waits for workers does it

    @property
    def here(self) -> "Engine":
        """The engine of this machine, for jobs that write where only it may."""
        return self

    def pays(self, cost: float) -> bool:
        """Return whether jobs that would take ``cost`` seconds here are worth handing over."""
        return False

    def run(
        self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J] = str,
        beside: Tasks = (), cost: float = float("inf"),
    ) -> Generator[R, None, None]:  # fmt: skip
        """Yield ``work(job)`` of every job, in the order of ``jobs``. A job that fails leaves the rest: the
        first failure is raised in its turn, after the others were done. ``name`` says what a job reads, for
        the error of an unforeseen fault. ``beside`` is done here, until the last result was taken. Jobs whose
        ``cost`` here [s] is not worth handing over are done here."""
        outcomes = (self if self.pays(cost) else Engine())._done(work, jobs, name, beside)
        for outcome in outcomes:
            if isinstance(outcome, Failure):
                more = [getattr(o, "what", o) for o in outcomes if isinstance(o, Failure)]
                if more and isinstance(outcome, FleetlogError):
                    outcome.do = f"{outcome.do or 'repair it'} ({len(more)} more failed: {more[0]})"
                raise outcome
            yield outcome

    def _done(self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J], beside: Tasks) -> Outcomes[R]:
        """Results and errors, in the order of the jobs."""
        for task in beside:
            task()
        yield from (attempt(work, job, name) for job in jobs)

    def stream(self, work: Callable[[J], R], jobs: Iterator[J], cost: float) -> Generator[R, None, None]:
        """Yield ``work(job)`` of every job, in their order; for work in C, which lets other threads run."""
        yield from map(work, jobs)

    def close(self) -> None:
        """Leave everything as it was."""


def attempt(work: Callable[[J], R], job: J, name: Name[J]) -> R | Failure:
    """The result of one job, or the error of a job that failed."""
    try:
        return work(job)
    except (FleetlogError, OSError) as error:
        return error  # of an OSError, whoever holds the place of the output knows more
    except MemoryError:
        return DataError("out of memory", where=name(job), do="use fewer --workers")
    except Exception as error:
        inner = getattr(work, "__wrapped__", getattr(work, "func", work))
        called = str(getattr(inner, "__name__", type(inner).__name__)).strip("_").replace("_", " ")
        return DataError(fault(called, error), where=name(job), do="please report it")


_current: ContextVar[Engine] = ContextVar("engine", default=Engine())  # noqa: B039 - it holds no state
current = _current.get  # Return the engine of the innermost :func:`using`; without one, jobs run here


def loading(*modules: str) -> Tasks:
    """The tasks of loading modules."""
    return [partial(import_module, name) for name in modules]


@contextmanager
def using(workers: int | None = None, scheduler: str | None = None) -> Iterator[Engine]:
    """Run the jobs of all library functions in this block on an engine.

    workers : processes of this machine; by default the cores there are, and where work is small, none.
    scheduler : address of a Dask scheduler (``tcp://HOST:PORT``) in place of this machine."""
    from fleetlog.engines.processes import Processes

    here = Processes(workers or cores(), always=bool(workers))
    engine = here if scheduler is None else Cluster(scheduler)
    token = _current.set(engine)
    try:
        yield engine
    finally:
        _current.reset(token)
        engine.close()


def cores() -> int:
    """Processes worth starting: the cores that this one may use, as far as memory goes round."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        return usable
    return max(1, min(usable, memory // PER_WORKER))


TIMEOUT = 20  # For the scheduler to answer [s]


class Cluster(Engine):
    """A Dask cluster; its workers have fleetlog installed and see the same files under the same names."""

    def __init__(self, address: str) -> None:
        distributed = extra("distributed", "cluster", "a Dask cluster needs dask.distributed", address)
        try:
            self.client: Any = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            what = f"no Dask scheduler answers ({error})"
            raise InputError(what, where=address, do="check the address") from None

    @property
    def workers(self) -> int:  # type: ignore[override]  # it may grow
        """Threads of all workers."""
        return max(1, sum(int(n) for n in self.client.nthreads().values()))

    @property
    def here(self) -> Engine:
        """Jobs are done in turn."""
        return Engine()

    def pays(self, cost: float) -> bool:
        """Always: who names a cluster wants it used."""
        return True

    def _done(self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J], beside: Tasks) -> Outcomes[R]:
        """The scheduler gives the jobs of a lost worker to others."""
        from distributed import KilledWorker

        futures, tasks = list[Any](), list(beside)
        try:
            for turn, job in enumerate(jobs):
                more = jobs[turn + len(futures) : turn + AHEAD * self.workers]
                futures += [self.client.submit(_unpacked, _packed(work, j, name), pure=False) for j in more]
                while tasks:
                    tasks.pop(0)()
                try:
                    yield futures.pop(0).result()
                except KilledWorker as error:
                    what, do = f"its workers died ({error})", "give the workers more memory"
                    yield DataError(what, where=name(job), do=do)
        finally:
            self.client.cancel(futures)

    def close(self) -> None:
        """Leave the cluster as it was."""
        self.client.close()


def _packed(*job: Any) -> bytes:
    """A job for a worker in whatever folder: its paths are absolute; the scheduler does not open it."""
    from cloudpickle import Pickler

    class Absolute(Pickler):  # type: ignore[misc]  # it carries no types
        absolute: ClassVar = {type(Path()): lambda path: (Path, (str(path.absolute()),))}
        dispatch_table: ClassVar = ChainMap(absolute, Pickler.dispatch_table)

    Absolute(out := BytesIO()).dump(job)
    return out.getvalue()


def _unpacked(job: bytes) -> Any:
    """What a job on a worker came to; what it reads is opened there."""
    return attempt(*pickle.loads(job))


def address(value: Any) -> str:
    """Return the address of a scheduler; ``ValueError`` where it cannot be one."""
    if not re.fullmatch(r"((tcp|tls|ws|wss)://)?[^/\s]+:\d+/?", str(value)):
        raise ValueError(f"{value!r} is no address of a scheduler; write tcp://HOST:PORT")
    return str(value)
