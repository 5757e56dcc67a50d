"""Who hears how far a run is: the command line, a notebook, nobody.  Library code never prints."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from fleetlog import interrupt


@dataclass(frozen=True)
class Listener:
    """What to do with progress (a text and the share done, 0 to 1) and with notices (one line each)."""

    progress: Callable[[str, float], None] = lambda text, share: None
    notice: Callable[[str], None] = lambda text: None


NOBODY = Listener()
_listener: ContextVar[Listener] = ContextVar("listener")


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
    _listener.get(NOBODY).progress(text, share)


def notice(text: str) -> None:
    """Report something that is worth a line but is no part of the answer."""
    _listener.get(NOBODY).notice(text)
