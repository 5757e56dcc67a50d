"""Interrupts that are never lost: Ctrl-C, SIGTERM and SIGHUP end a run, never in the middle of a swap."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

TOLD = "fleetlog: interrupted; nothing was written"
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_state = {"installed": False, "came": False, "held": False}


def install() -> None:
    """Turn the signals into :class:`KeyboardInterrupt`; the command line calls it once, in its main thread. A
    signal that the caller has set to be ignored (``nohup``, a background job) stays ignored."""
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _remember)
    _state["installed"] = True


def ignore() -> None:
    """Let no signal change the status of a run that is over."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def later() -> Iterator[None]:
    """A block that signals wait for: one that comes while Python forks is lost or breaks its set-up."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def obey() -> None:
    """Let a worker end, cleaning up, when its parent says so (SIGTERM); a terminal sends signals to all."""
    for number in SIGNALS:  # None in two steps: to ignore one, be it for a moment, drops one that waits
        signal.signal(number, (lambda *_: sys.exit()) if number == signal.SIGTERM else signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _remember(_signal: int, _frame: FrameType | None) -> None:
    _state["came"] = True
    if not _state["held"]:
        raise KeyboardInterrupt


def came() -> bool:
    """Whether one came, be it that a library swallowed the exception."""
    return _state["came"]


def answered() -> None:
    """Forget an interrupt that ended what it was meant to end: a capture that its user stops is whole."""
    _state["came"] = False


def check() -> None:
    """Raise an interrupt that a library swallowed: extension modules drop one that comes while they load."""
    if _state["came"]:
        raise KeyboardInterrupt


def keep_from_arrow() -> None:
    """Stop Arrow from putting its own handler of Ctrl-C in place while it reads."""
    if _state["installed"]:
        import pyarrow as pa

        pa.enable_signal_handlers(False)


@contextmanager
def held() -> Iterator[None]:
    """A block that no interrupt breaks; one that came before it is raised instead of entering."""
    if not (before := _state["held"]):
        check()
    _state["held"] = True
    try:
        yield
    finally:
        _state["held"] = before
