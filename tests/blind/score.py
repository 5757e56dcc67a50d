"""Judge a diagnosis against a sealed key.

right      exactly the terms of the key are named (for effects outside the vocabulary: unknown, following the right variable)
undecided  the true term is among ``not_excluded`` of what was named, or the verdict is ``unknown`` where a term was true
missed     nothing was found where something is
extra      the true terms are named, and another one too
wrong      a term is named with certainty and is not true
"""

from __future__ import annotations

from typing import Any

import numpy as np
from effects import FOLLOWS, OUTSIDE


def judge(key: dict[str, Any], found: dict[str, Any]) -> str:
    """One word; see above."""
    truth = {t for t in key["terms"] if t not in OUTSIDE}
    outside = [t for t in key["terms"] if t in OUTSIDE]
    findings = found["findings"]
    named = {f["term"] for f in findings if f["term"] != "unknown"}
    if not truth and not outside:
        return "right" if not findings else "false alarm"
    if not findings:
        return "missed"
    if outside and not truth:
        if named:
            return "wrong"
        follows = {d for f in findings for d in f["depends_on"]}
        return "right" if follows & FOLLOWS[outside[0]] else "undecided"
    if named == truth:
        return "right" if not any(f["term"] == "unknown" for f in findings) else "extra"
    possible = named | {n for f in findings for n in f["not_excluded"]}
    if truth <= named:
        return "extra"
    if truth <= possible or not named:
        return "undecided"
    return "wrong" if not truth & named else "partly"


def parameters(key: dict[str, Any], found: dict[str, Any]) -> list[dict[str, Any]]:
    """Every true number beside its estimate: term, name, truth, value, low, high."""
    out = []
    for term, truth in key["effect"].items():
        for f in found["findings"]:
            if f["term"] != term:
                continue
            given = {p["name"]: p for p in f["parameters"]}
            true = dict(truth)
            if term == "wind":
                true = {
                    "wind_east": truth["speed"] * np.cos(truth["angle"]),
                    "wind_north": truth["speed"] * np.sin(truth["angle"]),
                }
            for name, value in true.items():
                if name in given and isinstance(value, float):
                    p = given[name]
                    out.append(
                        {
                            "term": term,
                            "name": name,
                            "truth": value,
                            **{k: p[k] for k in ("value", "low", "high")},
                        }
                    )
    return out


def overlap(key: dict[str, Any], found: dict[str, Any]) -> float | None:
    """Roads named and true over roads named or true; None where the key has no roads."""
    if not key["where"]:
        return None
    true = set(key["where"])
    named: set[str] = set()
    for f in found["findings"]:
        if f["term"] in key["terms"] and f["where"]:
            named |= {e["edge_id"].removeprefix("-") for e in f["where"]["edges"]}
    return len(true & named) / max(len(true | named), 1)
