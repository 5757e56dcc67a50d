"""Ctrl-C that is never lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """Within the block, Ctrl-C ends the command even where a library swallows it; the callable given raises if it came.

    Extension modules drop a ``KeyboardInterrupt`` that reaches them while they are loaded, and Arrow puts its own handler in
    place while it reads; so the signal is remembered, and asked for between the steps of the work and at its end.
    """
    import pyarrow as pa

    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    came = False

    def remember(_signal: int, _frame: FrameType | None) -> None:
        nonlocal came
        came = True
        raise KeyboardInterrupt

    def check() -> None:
        if came:
            raise KeyboardInterrupt

    pa.enable_signal_handlers(False)
    before = signal.signal(signal.SIGINT, remember)
    try:
        yield check
    except Exception:
        check()  # a library that was torn out of its loading fails in its own way
        raise
    finally:
        signal.signal(signal.SIGINT, before)
