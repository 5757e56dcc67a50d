"""What is looked at again and again, one piece after the other, lies in scratch files: memory does not grow
with the days, and all processes of a machine share what one of them has made."""

import io
import mmap
import os
import pickle
import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np

from fleetlog import scratch

ALIGNED = 64  # Bytes: arrays begin at multiples of it, as in memory
HEAD = 8  # Bytes that say how long what comes before the arrays is
_elsewhere: dict[Path, Path] = {}  # The folder here of one on another machine


class Shelf:
    """Pieces by group and number; their arrays lie in files as in memory: only what is looked at is read."""

    def __init__(self) -> None:
        self._folder, self._owner = scratch.folder(), os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        return {"_folder": self._folder, "_owner": 0}

    def __del__(self) -> None:
        if self._owner == os.getpid():
            shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def folder(self) -> Path:
        """Where the pieces are; on another machine a folder of its own process."""
        if not self._folder.is_dir() and self._folder not in _elsewhere:
            _elsewhere[self._folder] = scratch.folder()
        return _elsewhere.get(self._folder, self._folder)

    def has(self, group: str) -> bool:
        """Return whether a group is whole."""
        return (self.folder / group / "whole").exists()

    def put(self, group: str, number: int, piece: Any) -> None:
        """Put a piece into a group; in a file that appears whole."""
        arrays, rest = list[pickle.PickleBuffer](), io.BytesIO()
        _Writer(rest, pickle.HIGHEST_PROTOCOL, buffer_callback=arrays.append).dump(piece)
        file = self.folder / group / f"{number:09d}"
        new = file.with_name(f"{file.name}.{os.getpid()}.{threading.get_ident()}")
        file.parent.mkdir(exist_ok=True)
        with new.open("wb") as stream:
            head = pickle.dumps((rest.getvalue(), [memoryview(a).nbytes for a in arrays]))
            stream.write(len(head).to_bytes(HEAD, "little") + head)
            for array in arrays:
                stream.write(bytes(-stream.tell() % ALIGNED))
                stream.write(array.raw())
        new.replace(file)

    def end(self, group: str) -> None:
        """Say that a group is whole."""
        (self.folder / group).mkdir(exist_ok=True)
        (self.folder / group / "whole").touch()

    def drop(self, group: str) -> None:
        """Keep a group no longer."""
        shutil.rmtree(self.folder / group)

    def numbers(self, group: str) -> list[int]:
        """Return the numbers of the pieces of a group, in order."""
        return sorted(int(f.name) for f in (self.folder / group).iterdir() if f.name.isdecimal())

    def get(self, group: str, number: int) -> Any:
        """Return a piece."""
        with (self.folder / group / f"{number:09d}").open("rb") as stream:
            held = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY))
        end = HEAD + int.from_bytes(held[:HEAD], "little")
        rest, sizes = pickle.loads(held[HEAD:end])
        arrays = []
        for size in sizes:
            begin = end + -end % ALIGNED
            end = begin + size
            arrays.append(held[begin:end])
        return pickle.loads(rest, buffers=arrays)


class _Writer(pickle.Pickler):
    def reducer_override(self, obj: Any) -> Any:
        """Keep an array that is one value repeated as one value."""
        if isinstance(obj, np.ndarray) and obj.strides == (0,) and len(obj):
            return np.broadcast_to, (obj[:1].copy(), obj.shape)
        return NotImplemented
