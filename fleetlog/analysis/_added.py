"""Analyses that other packages add, for the report: those that ask for nothing but a dataset and a truck."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

from fleetlog.core.result import Result
from fleetlog.core.truck import Truck
from fleetlog.errors import DataError
from fleetlog.registry import added, part
from fleetlog.store import Dataset


def added_results(dataset: Dataset, truck: Truck | None = None) -> Iterator[Result]:
    """Give the result of every added analysis that these data can answer."""
    for name in added("fleetlog.analysis"):
        function = part("fleetlog.analysis", "ANALYSIS", name)
        needed = [p.name for p in inspect.signature(function).parameters.values() if p.default is p.empty][1:]
        options: dict[str, Any] = {} if truck is None or "truck" not in needed else {"truck": truck}
        if set(needed) <= options.keys():
            try:
                yield function(dataset, **options)
            except DataError:  # these data cannot answer it
                continue
