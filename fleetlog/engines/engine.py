"""What an engine is: it does jobs, in any order, and gives their results in the order of the jobs."""

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, TypeAlias, TypeVar

from fleetlog.errors import DataError, FleetlogError, fault

J = TypeVar("J")
R = TypeVar("R")
Name: TypeAlias = Callable[[J], str]
AHEAD = 4
"""Jobs per worker that may be done before their turn; their results wait in memory."""


class Engine:
    """Does jobs; function, jobs and results must be picklable.  This one does them here, in turn."""

    workers = 1
    """Jobs that run at the same time."""

    def pays(self, cost: float) -> bool:
        """Return whether jobs that would take ``cost`` seconds here are worth handing over."""
        return False

    def run(self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J] = str) -> Generator[R, None, None]:
        """Yield ``work(job)`` of every job, in the order of ``jobs``.

        A job that fails leaves the rest: the first failure is raised in its turn, after the others were done.
        ``name`` says what a job reads, for the error of an unforeseen fault.
        """
        return successes(attempt(work, job, name) for job in jobs)

    def close(self) -> None:
        """Leave everything as it was."""


class Serial(Engine):
    """No other process takes part."""


def attempt(work: Callable[[J], R], job: J, name: Name[J]) -> R | FleetlogError:
    """The result of one job, or the error of a job that failed."""
    try:
        return work(job)
    except FleetlogError as error:
        return error
    except MemoryError:
        return DataError("out of memory", where=name(job), do="use fewer --workers")
    except Exception as error:
        return DataError(fault(_called(work), error), where=name(job), do="please report it")


def _called(work: Callable[..., Any]) -> str:
    inner = getattr(work, "__wrapped__", getattr(work, "func", work))
    return str(getattr(inner, "__name__", type(inner).__name__)).strip("_").replace("_", " ")


def successes(outcomes: Iterator[R | FleetlogError]) -> Generator[R, None, None]:
    """Yield results up to the first failure, which is raised when the rest has been done."""
    for outcome in outcomes:
        if isinstance(outcome, FleetlogError):
            if more := sum(isinstance(o, FleetlogError) for o in outcomes):
                outcome.do = f"{outcome.do or 'repair it'} ({more} more failed)"
            raise outcome
        yield outcome
