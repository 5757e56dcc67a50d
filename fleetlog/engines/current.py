"""The engine that library functions use: one for a block of code, chosen by who calls them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from fleetlog.engines.engine import Engine, Serial
from fleetlog.engines.processes import Processes
from fleetlog.errors import DataError

PER_WORKER = 1 << 30
"""Memory that is reckoned for a worker by default [bytes]."""
_current: ContextVar[Engine] = ContextVar("engine", default=Serial())  # noqa: B039 - it holds no state


def current() -> Engine:
    """Return the engine of the innermost :func:`using`; without one, jobs run here."""
    return _current.get()


@contextmanager
def using(workers: int | None = None, scheduler: str | None = None) -> Iterator[Engine]:
    """Run the jobs of all library functions in this block on an engine.

    Parameters
    ----------
    workers : processes of this machine; by default the cores there are, and where work is small, none.
    scheduler : address of a Dask scheduler (``tcp://HOST:PORT``) in place of this machine.
    """
    if scheduler is not None and workers is not None:
        raise DataError("workers and scheduler do not go together", do="give one of them")
    if scheduler is not None:
        from fleetlog.engines.cluster import Cluster

        engine: Engine = Cluster(scheduler)
    else:
        engine = Processes(workers, always=True) if workers else Processes(cores())
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
