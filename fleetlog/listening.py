"""Who hears how far a run is: the command line, a notebook, nobody.  Library code never prints."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing import parent_process
from typing import Any

from fleetlog import interrupt

Progress = Callable[[str, float], None]
Notice = Callable[[str], None]


def unheard(*_said: Any) -> None:
    """Nobody listens."""


_listener: ContextVar[tuple[Progress, Notice]] = ContextVar("listener", default=(unheard, unheard))


@contextmanager
def listening(progress: Progress, notice: Notice) -> Iterator[None]:
    """Hand on the progress (a text and the share done, 0 to 1) and the notices (a line each) of the block."""
    token = _listener.set((progress, notice))
    try:
        yield
    finally:
        _listener.reset(token)


def progress(text: str, share: float) -> None:
    """Report how far a run is, which workers leave to it; raises an interrupt that a library swallowed."""
    interrupt.check()
    if parent_process() is None:
        _listener.get()[0](text, share)


def notice(text: str) -> None:
    """Report something that is worth a line but is no part of the answer."""
    _listener.get()[1](text)
