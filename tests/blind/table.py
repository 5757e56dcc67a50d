"""Judge the lines of run.py: one table with the bars, then where the answers come from.

python table.py RESULTS.jsonl ...
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from breakdown import confusion, curves, intervals, scopes, words
from effects import OUTSIDE
from judged import crowded, effects, inside, load
from score import LATE, Json

NOTICEABLE = 0.1
"""Share of the held-out error that the true term removes where an effect must be named."""
MUCH = 0.02
"""Share of travel time lost to others that must be reported."""


def bars(rows: list[Json]) -> None:
    """What is asked for, beside what was reached."""
    print("| | bar | reached |\n| --- | --- | --- |")
    wanted = [(r, e) for r, e in effects(rows) if e["share"] >= NOTICEABLE]
    _naming(wanted)
    _honesty(rows)
    _scoping(wanted)
    shares = [r["congestion"] for r in rows if r.get("congestion") and r["congestion"]["truth"] >= MUCH]
    _bar("share of congestion within a quarter, where 2 % or more", "all", shares, _share_right)
    _bar("wrong truck files told as adjustments", "", [a for r in rows for a in r.get("adjusted", ())], bool)
    _bar("no answer", "none", rows, lambda r: r["word"] == "crashed")
    _bar("not a number, or on a bound", "none", rows, lambda r: bool(r["faults"]))
    print(f"\nmedian seconds of CPU: record, import, diagnose {_seconds(rows)}")


def _naming(wanted: list[tuple[Json, Json]]) -> None:
    plain = [e["told"] for r, e in wanted if not crowded(r)]
    dense = [e["told"] for r, e in wanted if crowded(r)]
    _bar("noticeable effects named", "at least 90 %", plain, "named".__eq__)
    _bar("... undecided", "", plain, "undecided".__eq__)
    _bar("noticeable effects named, three or more or two on a road", "at least 75 %", dense, "named".__eq__)


def _honesty(rows: list[Json]) -> None:
    answered = [r for r in rows if r["word"] != "crashed"]
    clean = [r for r in answered if not r["key"]["terms"]]
    concealing = [r for r in answered if r["key"]["terms"]]
    outside = [r["word"] for r in concealing if set(r["key"]["terms"]) & set(OUTSIDE)]
    numbers = [n for _, e in effects(rows) for n in e["numbers"]]
    over = [v for r in concealing if r["found"]["verdict"] == "found" for v in r["excess"].values()]
    _bar("false alarms on clean recordings", "at most 2 %", clean, lambda r: r["word"] == "false alarm")
    _bar("certain and wrong", "at most 2 %", concealing, lambda r: r["certain"])
    _bar("outside the vocabulary: unknown, with what it follows", "", outside, "right".__eq__)
    _bar("intervals that hold the truth", "92 to 98 %", numbers, inside)
    _bar("after within 1.2 of the floor where found", "all", over, lambda v: v <= 1.2)


def _scoping(wanted: list[tuple[Json, Json]]) -> None:
    named = [("scope=" in r["case"], e) for r, e in wanted if e["told"] == "named"]
    scoped = [e for has_scope, e in named if has_scope]
    others = [e["scope"] for has_scope, e in named if not has_scope]
    late = [e["late"] for e in scoped if e["late"] is not None]
    _bar("scope right, of scoped effects named", "at least 90 %", [e["scope"] for e in scoped], bool)
    _bar("no scope claimed, of the others named", "", others, bool)
    _bar("time of a change within 5 %", "", late, lambda v: v <= LATE)


def _bar(name: str, bar: str, of: list[Any], holds: Callable[[Any], bool]) -> None:
    count = sum(bool(holds(one)) for one in of)
    print(f"| {name} | {bar} | {f'{count / len(of):.1%} ({count} of {len(of)})' if of else 'none seen'} |")


def _share_right(c: Json) -> bool:
    return c["told"] is not None and abs(c["told"] - c["truth"]) <= 0.25 * c["truth"]


def _seconds(rows: list[Json]) -> str:
    whole = [r["seconds"] for r in rows if len(r.get("seconds", ())) == 3]
    return ", ".join(f"{v:.1f}" for v in np.median(whole, axis=0)) if whole else ""


def _family(row: Json) -> str:
    return row["family"] or "single"


def _of(name: str, families: tuple[str, ...]) -> Callable[[Json], str | None]:
    return lambda row: row.get("key", {}).get(name) if row["family"] in families else None


def main() -> None:
    """See the module's own words."""
    rows = load(sys.argv[1:])
    bars(rows)
    words("family", rows, _family)
    curves(rows)
    intervals(rows)
    scopes(rows)
    words("clean, logger", rows, _of("logger", ("clean",)))
    words("clean, site", rows, _of("site", ("clean",)))
    words("one term, logger", rows, _of("logger", ("loggers",)))
    words("one term, site", rows, _of("site", ("sites",)))
    confusion(rows)


if __name__ == "__main__":
    main()
