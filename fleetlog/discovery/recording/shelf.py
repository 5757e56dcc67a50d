"""What is looked at again and again, one piece after the other: in memory while the recording is small, else
in a scratch file, so that memory does not grow with the days."""

import io
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from fleetlog import scratch
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory

T = TypeVar("T")
SHARED = (Network, Trajectory)  # What pieces refer to, and is in memory anyway


class Shelf(Generic[T]):
    """Pieces in the order in which they were added; ``on_disk`` each is read anew when its turn comes."""

    def __init__(self, on_disk: bool) -> None:
        self._pieces: list[T] = []
        self._file: Path | None = scratch.folder() / "pieces" if on_disk else None
        self._ends, self._known = [0], dict[int, Any]()

    def __del__(self) -> None:
        if self._file is not None:
            self._file.unlink(missing_ok=True)

    def __len__(self) -> int:
        return len(self._pieces) if self._file is None else len(self._ends) - 1

    def add(self, piece: T) -> None:
        """Put a piece after the others."""
        if self._file is None:
            self._pieces.append(piece)
            return
        with self._file.open("ab") as file:
            _Writer(file, self._known).dump(piece)
            self._ends.append(file.tell())

    def __getitem__(self, k: int) -> T:
        if self._file is None:
            return self._pieces[k]
        with self._file.open("rb") as file:
            file.seek(self._ends[k])
            packed = io.BytesIO(file.read(self._ends[k + 1] - self._ends[k]))
        piece: T = _Reader(packed, self._known).load()
        return piece

    def __iter__(self) -> Iterator[T]:
        for k in range(len(self)):
            yield self[k]


class _Writer(pickle.Pickler):
    def __init__(self, file: Any, known: dict[int, Any]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.known = known

    def persistent_id(self, obj: Any) -> int | None:
        """Return the number of what is in memory anyway."""
        if not isinstance(obj, SHARED):
            return None
        self.known[id(obj)] = obj
        return id(obj)

    def reducer_override(self, obj: Any) -> Any:
        """Keep an array that is one value repeated as one value."""
        if isinstance(obj, np.ndarray) and obj.strides == (0,) and len(obj):
            return np.broadcast_to, (obj[:1].copy(), obj.shape)
        return NotImplemented


class _Reader(pickle.Unpickler):
    def __init__(self, file: Any, known: dict[int, Any]) -> None:
        super().__init__(file)
        self.known = known

    def persistent_load(self, pid: int) -> Any:
        """Return it again."""
        return self.known[pid]
