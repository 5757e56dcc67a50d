"""Jobs on a running Dask cluster, reached by the address of its scheduler."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from fleetlog.engines.engine import AHEAD, Engine, J, Name, R, attempt
from fleetlog.errors import DataError, FleetlogError, InputError
from fleetlog.registry import extra

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

    def pays(self, cost: float) -> bool:
        """Always: who names a cluster wants it used."""
        return True

    def _done(self, work: Callable[[J], R], jobs: Sequence[J], name: Name[J]) -> Iterator[R | FleetlogError]:
        """The scheduler gives the jobs of a lost worker to others."""
        futures: list[Any] = []
        try:
            for turn, job in enumerate(jobs):
                for later in jobs[turn + len(futures) : turn + AHEAD * self.workers]:
                    futures.append(self.client.submit(attempt, work, later, name, pure=False))
                yield self._outcome(futures[0], name(job))
                del futures[0]
        finally:
            self.client.cancel(futures)

    def _outcome(self, future: Any, name: str) -> Any:
        from distributed import KilledWorker

        try:
            return future.result()
        except KilledWorker as error:
            return DataError(f"its workers died ({error})", where=name, do="give the workers more memory")

    def close(self) -> None:
        """Leave the cluster as it was."""
        self.client.close()
