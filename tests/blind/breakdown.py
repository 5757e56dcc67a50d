"""Where the answers of a benchmark come from: detection curves, intervals, counts by kind, scopes, mistakes."""

from __future__ import annotations

import collections
import itertools
from collections.abc import Callable, Iterator

import numpy as np
from effects import OUTSIDE, TERMS
from judged import effects, inside
from score import LATE, Json

SHARES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
WORDS = ("right", "undecided", "extra", "partly", "missed", "wrong", "false alarm", "crashed")


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
    held = sum(map(inside, numbers))
    width = f"{half / error:.1f}" if error > 0 else ""
    where = f"{np.mean(places):.2f}" if places else ""
    print(f"| {name} | {len(numbers)} | {error:.1%} | {held}/{len(numbers)} | {width} | {where} |")


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
