"""A question asked of every part of a dataset: on the engine in use, with what was found before.

Partial results are kept in the dataset's folder, so that a question asked again reads only what is new:
``.partials/QUESTION/PART`` holds what a function made of a part, as ``date=DAY/vehicle_id=ID``.  QUESTION is
the digest of the function, its parameters, the site and fleetlog's own code; the file begins with that of the
parts it was made from (names, sizes, times of modification).  What does not agree is made anew.  Results are
dataclasses of arrays, numbers and texts; nothing found in a file is run."""

import hashlib
import io
import json
import math
import os
import shutil
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, partial, update_wrapper
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fleetlog import engines
from fleetlog.core.arrays import Array
from fleetlog.core.files import is_url
from fleetlog.store.dataset import Dataset
from fleetlog.store.output import PARTIALS

P = TypeVar("P")
QUESTIONS = 12  # So many questions are kept; of more, those that were asked longest ago go
LEVEL = 1  # Of zlib: most of a partial result are small numbers and zeros
ARRAY, KIND = "#array", "#kind"  # Keys of what JSON does not know
FROM_ROWS = 200_000  # A smaller dataset is read again as fast as its partial results would be
ROW_COST = 1e-6  # What a row costs a question, where it does not say otherwise [s]


@dataclass(frozen=True)
class Part:
    """A part of a dataset: its name as a path, what the question takes of it, the vehicle-days it reads."""

    name: str
    key: tuple[Any, ...]
    reads: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
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


def each_day(
    dataset: Dataset, work: Callable[..., P], *arguments: Any, kinds: Sequence[type] = (),
    vehicles: Sequence[str] = (), cost: float = ROW_COST, joined: bool = False,
) -> Generator[P, None, None]:  # fmt: skip
    """Yield ``work(dataset, vehicle, date, *arguments)`` for every vehicle-day, by vehicle and then by date.

    work : a function of a module, of which the result depends on nothing but its arguments; it returns
        plain data (see :func:`encode`).
    kinds : dataclasses that its result is made of; with any, results are kept in the dataset's folder.
    vehicles : only these; all by default.
    cost : of a row [s], about.
    joined : the work reads the vehicle's next day, too."""
    days = [d for d in dataset.vehicle_days if not vehicles or d[0] in vehicles]
    ends = zip_longest(days, days[1:], fillvalue=("", ""))
    reads = [(d, after) if joined and d[0] == after[0] else (d,) for d, after in ends]
    parts = [Part(dataset.folder_of(*d[0]), d[0], d) for d in reads]
    yield from each_part(dataset, parts, work, *arguments, kinds=kinds, cost=cost)


def each_part(
    dataset: Dataset, parts: Sequence[Part], work: Callable[..., P], *arguments: Any, kinds: Sequence[type],
    cost: float,
) -> Iterator[P]:  # fmt: skip
    """Yield ``work(dataset, *part.key, *arguments)`` for every part, in their order; see :func:`each_day`."""
    kept = partials_of(dataset, work, arguments, tuple(kinds)) if kinds else None
    missing = [p for p in parts if kept is None or not kept.has(p.name, dataset.source(p.reads))]
    cost *= dataset.rows * len(missing) / max(len(parts), 1)
    job = update_wrapper(partial(_answer, dataset, work, arguments, kept), work)
    new, place = {p.name for p in missing}, f"{dataset.path}/trajectories"
    with closing(engines.current().run(job, missing, lambda part: f"{place}/{part.name}", cost=cost)) as made:
        for part in parts:
            out = next(made) if part.name in new else kept.find(part.name) if kept else None
            yield job(part) if out is None else out


def _answer(
    dataset: Dataset, work: Callable[..., P], arguments: tuple[Any, ...], kept: Partials | None, part: Part
) -> P:
    """What the question makes of a part, which is kept."""
    dataset = dataset.here()
    out = work(dataset, *part.key, *arguments)
    if kept is not None:
        kept.keep(part.name, dataset.source(part.reads), out)
    return out


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
    for file in sorted([*package.rglob("*.py"), *package.rglob("*.toml")]):
        digest.update(str(file.relative_to(package)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def encode(value: Any) -> bytes:
    """Bytes that depend on the value alone, not on the process or on the order of a set. JSON of eight bytes'
    length and then the arrays, one behind the other; tuples and sets are lists in it."""
    arrays: list[Array] = []

    def told(value: Any) -> Any:
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            arrays.append(value)
            return {ARRAY: value.dtype.str, "shape": value.shape}
        if isinstance(value, set | frozenset):
            return sorted(value)
        if is_dataclass(value):
            own = {f.name: getattr(value, f.name) for f in fields(value)}
            return {KIND: type(value).__name__, "fields": own}
        raise TypeError(f"{type(value).__name__} is not plain data")

    head = json.dumps(value, default=told).encode()
    return b"".join([len(head).to_bytes(8, "little"), head, *(np.ascontiguousarray(a).data for a in arrays)])


def pack(value: Any) -> bytes:
    """Encoded and compressed, with zlib's checksum."""
    return zlib.compress(encode(value), LEVEL)


def unpack(data: bytes, kinds: Iterable[type] = ()) -> Any:
    """What was packed; dataclasses of ``kinds`` alone.  ValueError where it is damaged or something else."""
    known = {kind.__name__: kind for kind in kinds}

    def made(told: dict[str, Any]) -> Any:
        if KIND in told:
            return known[told[KIND]](**told["fields"])
        if ARRAY not in told:
            return told
        dtype, shape = np.dtype(told[ARRAY]), told["shape"]
        if dtype.hasobject:
            raise ValueError("an array of objects is not plain data")
        return np.frombuffer(arrays.read(math.prod(shape) * dtype.itemsize), dtype).reshape(shape)

    try:
        arrays = io.BytesIO(zlib.decompress(data))
        return json.loads(arrays.read(int.from_bytes(arrays.read(8), "little")), object_hook=made)
    except (zlib.error, LookupError, TypeError) as error:
        raise ValueError(f"not plain data: {error}") from None
