"""Partial results kept in a dataset's folder, so that a question asked again reads only what is new.

``.partials/QUESTION/PART`` holds what a function made of a part, as ``date=DAY/vehicle_id=ID``.  QUESTION is
the digest of the function, its parameters, the site and fleetlog's own code; the file begins with that of the
parts it was made from (names, sizes, times of modification).  What does not agree is made anew.  Results are
dataclasses of arrays, numbers and texts; nothing found in a file is run.
"""

import dataclasses
import hashlib
import io
import json
import os
import shutil
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fleetlog.store.dataset import Dataset
from fleetlog.store.output import PARTIALS
from fleetlog.store.places import is_url

QUESTIONS = 12  # So many questions are kept; of more, those that were asked longest ago go
LEVEL = 1  # Of zlib: most of a partial result are small numbers and zeros
FROM_ROWS = 200_000  # A smaller dataset is read again as fast as its partial results would be


@dataclasses.dataclass(frozen=True)
class Partials:
    """The partial results of one question; ``kinds`` are the dataclasses that they are made of."""

    folder: Path
    kinds: tuple[type, ...]

    def has(self, name: str, source: bytes) -> bool:
        """Return whether a result is kept that was made from this source."""
        try:
            with (self.folder / name).open("rb") as stream:
                return stream.read(len(source)) == source
        except OSError:
            return False

    def find(self, name: str) -> Any:
        """A result that is kept; None where it has gone, is damaged or something else."""
        try:
            return unpack((self.folder / name).read_bytes()[32:], self.kinds)
        except (OSError, ValueError):
            return None

    def keep(self, name: str, source: bytes, value: Any) -> None:
        """Keep a result; a dataset that cannot be written goes without."""
        file, data = self.folder / name, source + pack(value)
        with suppress(OSError):
            if is_url(file):  # an object appears whole
                file.write_bytes(data)
                return
            file.parent.mkdir(parents=True, exist_ok=True)
            new = file.with_name(f"{file.name}.{os.getpid()}.new")
            new.write_bytes(data)
            new.replace(file)


def partials_of(
    dataset: Dataset, work: Callable[..., Any], arguments: tuple[Any, ...], kinds: tuple[type, ...]
) -> Partials | None:
    """Where the results of a question are kept; None for a small dataset or one that cannot be written."""
    root, remote = dataset.path / PARTIALS, is_url(dataset.path)
    if dataset.rows < FROM_ROWS or not (remote or os.access(dataset.path, os.W_OK)):
        return None
    asked = [f"{work.__module__}.{work.__qualname__}", code_digest(), dataset.site_text, arguments]
    folder = root / hashlib.sha256(encode(asked)).hexdigest()[:32]
    if not remote:
        with suppress(OSError):
            others = [p for p in root.glob("*") if p.is_dir() and p != folder]
            others.sort(key=lambda p: -p.stat().st_mtime_ns)
            for old in others[QUESTIONS - 1 :]:
                shutil.rmtree(old, ignore_errors=True)
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)
    return Partials(folder, kinds)


@cache
def code_digest() -> str:
    """The digest of fleetlog's own code: a partial result of another version is none."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def encode(value: Any) -> bytes:
    """Bytes that depend on the value alone, not on the process or on the order of a set."""
    arrays: list[NDArray[Any]] = []
    head = json.dumps(_tree(value, arrays)).encode()
    return b"".join([len(head).to_bytes(8, "little"), head, *(np.ascontiguousarray(a).data for a in arrays)])


def pack(value: Any) -> bytes:
    """Encoded and compressed, with zlib's checksum."""
    return zlib.compress(encode(value), LEVEL)


def unpack(data: bytes, kinds: Iterable[type] = ()) -> Any:
    """What was packed; dataclasses of ``kinds`` alone.  ValueError where it is damaged or something else."""
    try:
        plain = io.BytesIO(zlib.decompress(data))
        tree = json.loads(plain.read(int.from_bytes(plain.read(8), "little")))
        return _value(tree, plain, {k.__name__: k for k in kinds})
    except (zlib.error, LookupError, TypeError, StopIteration) as error:
        raise ValueError(f"not plain data: {error}") from None


def _tree(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return _tree(value.item(), arrays)
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects is not plain data")
        arrays.append(value)
        return {"array": value.dtype.str, "shape": value.shape}
    if isinstance(value, list | tuple):
        return {type(value).__name__: [_tree(v, arrays) for v in value]}
    if isinstance(value, set | frozenset):
        return {"set": [_tree(v, arrays) for v in sorted(value)]}
    if isinstance(value, dict):
        return {"dict": [[_tree(k, arrays), _tree(v, arrays)] for k, v in value.items()]}
    if dataclasses.is_dataclass(value):
        names = [f.name for f in dataclasses.fields(value)]
        return {"kind": type(value).__name__, "fields": {n: _tree(getattr(value, n), arrays) for n in names}}
    raise TypeError(f"{type(value).__name__} is not plain data")


def _value(tree: Any, data: io.BytesIO, kinds: Mapping[str, type]) -> Any:
    """The value of a tree; arrays are taken from ``data`` in order."""
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        dtype = np.dtype(tree["array"])
        if dtype.hasobject:
            raise ValueError("an array of objects is not plain data")
        size = int(np.prod(tree["shape"], dtype=np.int64)) * dtype.itemsize
        return np.frombuffer(data.read(size), dtype).reshape(tree["shape"])
    if "kind" in tree:
        return kinds[tree["kind"]](**{n: _value(v, data, kinds) for n, v in tree["fields"].items()})
    if "dict" in tree:
        return {_value(k, data, kinds): _value(v, data, kinds) for k, v in tree["dict"]}
    name, items = next(iter(tree.items()))
    return {"list": list, "tuple": tuple, "set": frozenset}[name](_value(v, data, kinds) for v in items)
