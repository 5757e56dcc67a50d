"""A place for compiled kernels where neither installation nor home can be written (containers, services)."""

import os
from pathlib import Path


def find_place() -> str | None:
    """Set ``NUMBA_CACHE_DIR`` to a folder of this run where numba's own choices cannot be written.

    Its name cannot be foreseen: numba loads what lies in it.
    """
    # Path.expanduser raises where there is no home.
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111
    if "NUMBA_CACHE_DIR" in os.environ or _writable(Path(__file__).parent) or _writable(Path(home)):
        return None
    import atexit
    import shutil
    import tempfile

    folder = tempfile.mkdtemp(prefix="fleetlog-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = folder
    return folder


def _writable(folder: Path) -> bool:
    """Whether ``folder``, or the nearest one above it that exists, can be written."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    # Kernel file systems let the superuser pass the question and then refuse.
    kernel = folder.parts[:2] in (("/", "proc"), ("/", "sys"))
    return os.access(folder, os.W_OK | os.X_OK) and not kernel
