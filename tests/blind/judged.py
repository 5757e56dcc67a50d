"""Lines of run.py with what is to be thought of them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from effects import OUTSIDE
from score import Json, adjusted, by_effect, certain_and_wrong, congestion, excess, faults, judge


def load(files: Iterable[str]) -> list[Json]:
    """Judged lines; the last of each case counts."""
    lines = [json.loads(line) for file in files for line in Path(file).read_text().splitlines()]
    return [judged(line) for line in {line["case"]: line for line in lines}.values()]


def judged(line: Json) -> Json:
    """A line with its word, its effects and its faults."""
    found, key = line.get("found"), line.get("key")
    if not found or not key:
        return line | {"word": "crashed", "effects": [], "certain": False, "faults": [], "excess": {}}
    return line | {
        "word": judge(key, found),
        "effects": list(by_effect(key, found)),
        "certain": certain_and_wrong(key, found),
        "adjusted": adjusted(key, found),
        "congestion": congestion(key, found),
        "faults": faults(found),
        "excess": excess(found),
    }


def crowded(row: Json) -> bool:
    """Three effects or more, or two on one road."""
    return len(row["effects"]) > 2 or "together=road" in row["case"]


def effects(rows: Iterable[Json]) -> Iterator[tuple[Json, Json]]:
    """(row, effect) of the vocabulary."""
    return ((r, e) for r in rows for e in r["effects"] if e["term"] not in OUTSIDE)


def inside(number: Json) -> bool:
    """Whether an interval holds the truth."""
    return bool(number["low"] <= number["truth"] <= number["high"])
