"""Jobs done here, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence

from fleetlog.engines.engine import J, R, attempt, successes


class Serial:
    """No other process takes part."""

    workers = 1

    def pays(self, cost: float) -> bool:
        """Never."""
        return False

    def run(
        self, work: Callable[[J], R], jobs: Sequence[J], name: Callable[[J], str] = str
    ) -> Generator[R, None, None]:
        """Yield the results; see :class:`~fleetlog.engines.engine.Engine`."""
        return successes(attempt(work, job, name) for job in jobs)
