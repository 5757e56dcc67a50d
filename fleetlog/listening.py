"""Who hears how far a run is: the command line, a notebook, nobody.  Library code never prints."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

from fleetlog import interrupt

Progress = Callable[[str, float], None]


def unheard(*_said: Any) -> None:
    """Nobody listens."""


class Listener(NamedTuple):
    """What to do with progress (a text and the share done, 0 to 1) and with notices (one line each)."""

    progress: Progress = unheard
    notice: Callable[[str], None] = unheard


_listener = ContextVar("listener", default=Listener())  # noqa: B039 - it holds no state


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Send progress and notices of the block to ``listener``."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def progress(text: str, share: float) -> None:
    """Report how far a run is; raises an interrupt that a library swallowed."""
    interrupt.check()
    _listener.get().progress(text, share)


def notice(text: str) -> None:
    """Report something that is worth a line but is no part of the answer."""
    _listener.get().notice(text)
