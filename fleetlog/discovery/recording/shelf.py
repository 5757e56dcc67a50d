"""What is looked at again and again, one piece after the other: in memory while the recording is small, else
in a scratch file, so that memory does not grow with the days."""

import io
import mmap
import pickle
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from fleetlog import scratch
from fleetlog.core.network import Network
from fleetlog.core.trajectory import Trajectory

T = TypeVar("T")
SHARED = (Network, Trajectory)  # What pieces refer to, and is in memory anyway
ALIGNED = 64  # Bytes: arrays begin at multiples of it, as in memory


class Shelf(Generic[T]):
    """Pieces in the order in which they were added; ``on_disk`` each is read anew when its turn comes, and of
    its arrays only what is looked at: they lie in the file as they would in memory."""

    def __init__(self, on_disk: bool, pieces: Iterable[T] = ()) -> None:
        self._pieces: list[T] = []
        self._file: Path | None = scratch.folder() / "pieces" if on_disk else None
        self._written, self._known = list[tuple[bytes, int, list[slice]]](), dict[int, Any]()
        for piece in pieces:
            self.add(piece)

    def __del__(self) -> None:
        if self._file is not None:
            self._file.unlink(missing_ok=True)

    def __len__(self) -> int:
        return len(self._pieces) if self._file is None else len(self._written)

    def add(self, piece: T) -> None:
        """Put a piece after the others."""
        if self._file is None:
            self._pieces.append(piece)
            return
        arrays, places, rest = list[pickle.PickleBuffer](), list[slice](), io.BytesIO()
        _Writer(rest, self._known, arrays.append).dump(piece)
        with self._file.open("ab") as file:
            begin = file.tell()
            for array in arrays:
                places.append(slice(start := file.tell() - begin, start + file.write(array.raw())))
                file.write(bytes(-file.tell() % ALIGNED))
            file.write(bytes(-file.tell() % mmap.ALLOCATIONGRANULARITY))
        self._written.append((rest.getvalue(), begin, places))

    def __getitem__(self, k: int) -> T:
        if self._file is None:
            return self._pieces[k]
        rest, begin, places = self._written[k]
        held = memoryview(b"")
        if places and (length := places[-1].stop):
            with self._file.open("rb") as file:
                held = memoryview(mmap.mmap(file.fileno(), length, access=mmap.ACCESS_COPY, offset=begin))
        piece: T = _Reader(rest, self._known, [held[at] for at in places]).load()
        return piece

    def __iter__(self) -> Iterator[T]:
        return map(self.__getitem__, range(len(self)))


class _Writer(pickle.Pickler):
    def __init__(self, file: Any, known: dict[int, Any], apart: Callable[[pickle.PickleBuffer], Any]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL, buffer_callback=apart)
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
    def __init__(self, rest: bytes, known: dict[int, Any], arrays: list[memoryview]) -> None:
        super().__init__(io.BytesIO(rest), buffers=arrays)
        self.known = known

    def persistent_load(self, pid: int) -> Any:
        """Return it again."""
        return self.known[pid]
