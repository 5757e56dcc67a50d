"""Reading a recording back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader


def column(path: Path, entity: str, component: str, timeline: str | None = "utc") -> tuple[np.ndarray, Any]:
    """(time [us], list array) of a component of an entity in order of time; ``timeline=None`` for static data."""
    times, values = [], []
    for chunk in (
        RrdReader(str(path)).stream().filter(content=entity, components=component, is_static=timeline is None)
    ):
        batch = chunk.to_record_batch()
        v = batch.column(component)
        known = v.is_valid()
        values.append(v.filter(known))
        t = batch.column(timeline).cast(pa.int64()) if timeline else pa.nulls(len(v), pa.int64()).fill_null(0)
        times.append(t.filter(known))
    if not values:
        return np.zeros(0, np.int64), None
    t, v = pa.chunked_array(times).combine_chunks().to_numpy(), pa.chunked_array(values).combine_chunks()
    order = np.argsort(t, kind="stable")
    return t[order] // 1000, v.take(pa.array(order))


def scalars(path: Path, entity: str) -> tuple[np.ndarray, np.ndarray]:
    t, v = column(path, entity, "Scalars:scalars")
    return t, np.zeros(0) if v is None else v.flatten().to_numpy()


def vectors(path: Path, entity: str, component: str) -> tuple[np.ndarray, np.ndarray]:
    t, v = column(path, entity, component)
    return t, v.flatten().flatten().to_numpy().reshape(len(t), -1)


def entities(path: Path) -> set[str]:
    lines = RrdReader(str(path)).store().summary().splitlines()
    return {line.split(" rows=")[0] for line in lines if " rows=" in line}


def views(path: Path) -> set[str]:
    reader = RrdReader(str(path))
    names = set()
    for chunk in reader.stream(store=reader.blueprints()[0]):
        batch = chunk.to_record_batch()
        if "ViewBlueprint:display_name" in batch.schema.names:
            names |= {n for row in batch.column("ViewBlueprint:display_name").to_pylist() for n in row or []}
    return names


def times(path: Path, entity: str) -> np.ndarray:
    """All times [us] at which an entity has something."""
    found = [np.zeros(0, np.int64)]
    for chunk in RrdReader(str(path)).stream().filter(content=entity, is_static=False):
        batch = chunk.to_record_batch()
        found.append(batch.column("utc").cast(pa.int64()).to_numpy() // 1000)
    return np.concatenate(found)
