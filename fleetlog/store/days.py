"""A question asked of every part of a dataset: on the engine in use, with what was found before."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial, update_wrapper
from typing import Any, TypeVar

from fleetlog import engines
from fleetlog.store.dataset import Dataset
from fleetlog.store.partials import Partials, partials_of

P = TypeVar("P")
ROW_COST = 1e-6  # What a row costs a question, where it does not say otherwise [s]


@dataclass(frozen=True)
class Part:
    """A part of a dataset: its name as a path, what the question takes of it, the vehicle-days it reads."""

    name: str
    key: tuple[Any, ...]
    reads: tuple[tuple[str, str], ...]


def each_day(
    dataset: Dataset, work: Callable[..., P], *arguments: Any, kinds: Sequence[type] = (),
    vehicles: Sequence[str] = (), cost: float = ROW_COST,
) -> Iterator[P]:  # fmt: skip
    """Yield ``work(dataset, vehicle, date, *arguments)`` for every vehicle-day, by vehicle and then by date.

    Parameters
    ----------
    work : a function of a module, of which the result depends on nothing but its arguments; it returns
        plain data (see :mod:`fleetlog.store.partials`).
    kinds : dataclasses that its result is made of; with any, results are kept in the dataset's folder.
    vehicles : only these; all by default.
    cost : of a row [s], about.
    """
    days = [d for d in dataset.vehicle_days if not vehicles or d[0] in vehicles]
    parts = [Part(dataset.folder_of(*d), d, (d,)) for d in days]
    yield from each_part(dataset, parts, work, *arguments, kinds=kinds, cost=cost)


def each_part(
    dataset: Dataset, parts: Sequence[Part], work: Callable[..., P], *arguments: Any, kinds: Sequence[type],
    cost: float,
) -> Iterator[P]:  # fmt: skip
    """Yield ``work(dataset, *part.key, *arguments)`` for every part, in their order; see :func:`each_day`."""
    kept = partials_of(dataset, work, arguments, tuple(kinds)) if kinds else None
    missing = [p for p in parts if kept is None or not kept.has(p.name, dataset.source(p.reads))]
    engine = engines.current()
    if not engine.pays(cost * dataset.rows * len(missing) / max(len(parts), 1)):
        engine = engines.Engine()
    job = update_wrapper(partial(_answer, dataset, work, arguments, kept), work)
    new = {p.name for p in missing}
    with closing(engine.run(job, missing, partial(_called, str(dataset.path)))) as made:
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


def _called(path: str, part: Part) -> str:
    return f"{path}/trajectories/{part.name}"
