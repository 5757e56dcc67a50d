"""``fleetlog``, and ``python -m fleetlog``: the command line, interruptible from its first moment."""

import os
from contextlib import suppress

from fleetlog import interrupt
from fleetlog.errors import EXIT_INTERRUPTED


def entry() -> None:
    """Run the command line; an interrupt that comes while it loads ends it as a later one does."""
    interrupt.install()
    try:
        from fleetlog.cli.main import entry as run
    except BaseException:
        if not interrupt.came():
            raise
        with suppress(OSError):
            os.write(2, f"{interrupt.TOLD}\n".encode())
        os._exit(EXIT_INTERRUPTED)
    run()


if __name__ == "__main__":
    entry()
