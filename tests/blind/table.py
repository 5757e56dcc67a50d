"""Judge the lines of run.py: one table with the bars, then where the answers come from.

python table.py RESULTS.jsonl ...
"""

from __future__ import annotations

import collections
import itertools
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from effects import OUTSIDE, TERMS
from score import LATE, Json, adjusted, by_effect, certain_and_wrong, congestion, excess, faults, judge

NOTICEABLE = 0.1
"""Share of the held-out error that the true term removes where an effect must be named."""
MUCH = 0.02
"""Share of travel time lost to others that must be reported."""
SHARES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
WORDS = ("right", "undecided", "extra", "partly", "missed", "wrong", "false alarm", "crashed")


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


def bars(rows: list[Json]) -> None:
    """What is asked for, beside what was reached."""
    clean = [r for r in rows if not r.get("key", {}).get("terms", ["?"])]
    wanted = [(r, e) for r, e in effects(rows) if e["share"] >= NOTICEABLE]
    plain = [e for r, e in wanted if not crowded(r)]
    dense = [e for r, e in wanted if crowded(r)]
    concealing = [r for r in rows if r.get("key", {}).get("terms")]
    outside = [r for r in concealing if set(r["key"]["terms"]) & set(OUTSIDE)]
    numbers = [n for _, e in effects(rows) for n in e["numbers"]]
    over = [v for r in rows if r.get("found", {}).get("verdict") == "found" for v in r["excess"].values()]
    scoped = [e for r, e in wanted if "scope=" in r["case"] and e["told"] == "named"]
    late = [e["late"] for e in scoped if e["late"] is not None]
    unasked = [e for r, e in wanted if "scope=" not in r["case"] and e["told"] == "named"]
    print("| | bar | reached |\n| --- | --- | --- |")
    _bar("noticeable effects named", "at least 90 %", plain, lambda e: e["told"] == "named")
    _bar("... undecided", "", plain, lambda e: e["told"] == "undecided")
    _bar(
        "noticeable effects named, three or more or two on a road",
        "at least 75 %",
        dense,
        lambda e: e["told"] == "named",
    )
    _bar("false alarms on clean recordings", "at most 2 %", clean, lambda r: r["word"] == "false alarm")
    _bar("certain and wrong", "at most 2 %", concealing, lambda r: r["certain"])
    _bar(
        "effects outside the vocabulary: unknown, with what it follows",
        "",
        outside,
        lambda r: r["word"] == "right",
    )
    _bar("intervals that hold the truth", "92 to 98 %", numbers, _inside)
    _bar("after within 1.2 of the floor where found", "all", over, lambda v: v <= 1.2)
    _bar("scope right, of scoped effects named", "at least 90 %", scoped, lambda e: e["scope"])
    _bar("no scope claimed, of the others named", "", unasked, lambda e: e["scope"])
    _bar("time of a change within 5 %", "", late, lambda v: v <= LATE)
    shares = [r["congestion"] for r in rows if r.get("congestion") and r["congestion"]["truth"] >= MUCH]
    _bar("share of congestion within a quarter, where 2 % or more", "all", shares, _share_right)
    _bar("wrong truck files told as adjustments", "", [a for r in rows for a in r.get("adjusted", ())], bool)
    _bar("no answer", "none", rows, lambda r: r["word"] == "crashed")
    _bar("not a number, or on a bound", "none", rows, lambda r: bool(r["faults"]))
    print(f"\nmedian seconds of CPU: record, import, diagnose {_seconds(rows)}")


def _bar(name: str, bar: str, of: list[Any], holds: Callable[[Any], bool]) -> None:
    count = sum(bool(holds(one)) for one in of)
    print(f"| {name} | {bar} | {f'{count / len(of):.1%} ({count} of {len(of)})' if of else 'none seen'} |")


def _share_right(c: Json) -> bool:
    return c["told"] is not None and abs(c["told"] - c["truth"]) <= 0.25 * c["truth"]


def _seconds(rows: list[Json]) -> str:
    whole = [r["seconds"] for r in rows if len(r.get("seconds", ())) == 3]
    return ", ".join(f"{v:.1f}" for v in np.median(whole, axis=0)) if whole else ""


def _inside(n: Json) -> bool:
    return bool(n["low"] <= n["truth"] <= n["high"])


def curves(rows: list[Json]) -> None:
    """Detection of every term by the share of the error that it makes; undecided ones after a plus."""
    heads = [f"{a:.0%} to {b:.0%}" for a, b in itertools.pairwise(SHARES)]
    print("\nNamed (+ undecided) of how many, by the share of the error that the true term removes:\n")
    print("| term | " + " | ".join(heads) + " |\n" + "| --- " * (len(heads) + 1) + "|")
    by: dict[str, list[Json]] = collections.defaultdict(list)
    for r in rows:
        for e in r["effects"]:
            by[e["term"]].append(e)
    for term in [t for t in (*TERMS, *OUTSIDE) if t in by]:
        print(f"| {term} | " + " | ".join(_cells(by[term])) + " |")
    print("| all of the vocabulary | " + " | ".join(_cells([e for _, e in effects(rows)])) + " |")


def _cells(told: list[Json]) -> Iterator[str]:
    for low, high in itertools.pairwise(SHARES):
        within = [e["told"] for e in told if low <= e["share"] < high]
        open_end = within.count("undecided")
        yield (
            f"{within.count('named')}{f'+{open_end}' if open_end else ''} of {len(within)}" if within else ""
        )


def intervals(rows: list[Json]) -> None:
    """Coverage and width by parameter."""
    print("\n| parameter | n | median error | in its interval | half width over median error | roads |")
    print("| --- " * 6 + "|")
    by: dict[str, list[Json]] = collections.defaultdict(list)
    places: dict[str, list[float]] = collections.defaultdict(list)
    for _, e in effects(rows):
        for n in e["numbers"]:
            by[f"{e['term']}.{n['name']}"].append(n)
        if e["overlap"] is not None:
            places[e["term"]].append(e["overlap"])
    for name in sorted(by):
        _interval(name, by[name], places.get(name.split(".")[0], []))


def _interval(name: str, numbers: list[Json], places: list[float]) -> None:
    error = np.median([abs(n["value"] - n["truth"]) / n["size"] for n in numbers])
    half = np.median([(n["high"] - n["low"]) / 2.0 / n["size"] for n in numbers])
    inside = sum(map(_inside, numbers))
    width = f"{half / error:.1f}" if error > 0 else ""
    where = f"{np.mean(places):.2f}" if places else ""
    print(f"| {name} | {len(numbers)} | {error:.1%} | {inside}/{len(numbers)} | {width} | {where} |")


def words(title: str, rows: list[Json], kind: Callable[[Json], str | None]) -> None:
    """Counts of words by some property of the cases."""
    by: dict[str, list[Json]] = collections.defaultdict(list)
    for r in rows:
        name = kind(r)
        if name is not None:
            by[name].append(r)
    if not by:
        return
    print(
        f"\n| {title} | n | "
        + " | ".join(WORDS)
        + " | certain and wrong | after over floor, median, largest |"
    )
    print("| --- " * (len(WORDS) + 4) + "|")
    for name, group in by.items():
        count = collections.Counter(r["word"] for r in group)
        cells = " | ".join(str(count[w] or "") for w in WORDS)
        over = [v for r in group for v in r["excess"].values()]
        shown = f"{np.median(over):.2f}, {max(over):.2f}" if over else ""
        print(f"| {name} | {len(group)} | {cells} | {sum(r['certain'] for r in group) or ''} | {shown} |")


def scopes(rows: list[Json]) -> None:
    """Scoped effects by kind of scope and term."""
    by: dict[str, list[Json]] = collections.defaultdict(list)
    for r in rows:
        if "scope=" in r["case"]:
            kind = r["case"].split("scope=")[1].split(",")[0]
            for e in r["effects"]:
                by[f"{kind}: {e['term']}"].append(e)
    if not by:
        return
    print(
        "\n| scope | n | named | undecided | scope right | time of change within 5 % |\n" + "| --- " * 6 + "|"
    )
    for name in sorted(by):
        told = [e["told"] for e in by[name]]
        named = [e for e in by[name] if e["told"] == "named"]
        late = [e["late"] for e in named if e["late"] is not None]
        print(
            f"| {name} | {len(told)} | {len(named)} | {told.count('undecided')} | "
            f"{sum(bool(e['scope']) for e in named)} | "
            f"{f'{sum(v <= LATE for v in late)} of {len(late)}' if late else ''} |"
        )


def confusion(rows: list[Json]) -> None:
    """What was said of what was concealed, where that was not right."""
    print("\nWhat went wrong:\n\n| case | word | said | oracle's shares |\n| --- | --- | --- | --- |")
    for r in rows:
        if r["word"] not in ("right", "undecided", "missed") or r["certain"] or r["faults"]:
            said = "; ".join(_said(f) for f in r.get("found", {}).get("findings", [])) or r.get(
                "error", "nothing"
            )
            shares = ", ".join(f"{e['share']:.2f}" for e in r["effects"])
            word = r["word"] + (", certain and wrong" if r["certain"] else "")
            last = said.strip().splitlines()[-1][:300]
            print(f"| {r['case']} | {word} | {'; '.join([last, *r['faults']])} | {shares} |")


def _said(finding: Json) -> str:
    name: str = finding["term"]
    if name == "unknown":
        name = f"unknown({','.join(finding['depends_on'])})"
    return name + (f" or {'/'.join(finding['not_excluded'])}" if finding["not_excluded"] else "")


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
