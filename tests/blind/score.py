"""Judge a diagnosis (format version 1 or 2) against the key of its recording.

right        exactly the terms of the key are named (of effects outside the vocabulary: unknown, and it
             follows the right variable)
undecided    the true term is among ``not_excluded`` of what was named, or something is ``unknown`` where a
             term was true
missed       nothing was found where something is
extra        the true terms are named, and another one too
partly       some of the true terms are named, others not
wrong        a term is named and no true one is
false alarm  something was said of a clean recording
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime
from typing import Any

ALIASES = {
    "interval": ("interval", "seconds", "duration"),
    "mass": ("mass",),
    "capacity": ("capacity", "capacity_wh", "usable_energy"),
    "seconds": ("seconds", "hold", "after"),
    "coefficient": ("coefficient", "resistance", "loss"),
}
"""Names under which a true number may be reported."""
LATE = 0.05
"""Share of the recording by which the time of a change may be off."""
Json = dict[str, Any]


def judge(key: Json, found: Json) -> str:
    """One word; see above."""
    findings, truth = _asserted(key, found), set(key["terms"])
    named = {f["term"] for f in findings if f["term"] != "unknown"}
    open_end = any(f["term"] == "unknown" for f in findings) or (
        found["verdict"] == "unknown" and not findings
    )
    if not truth:
        return "false alarm" if findings or open_end else "right"
    if not findings and not open_end:
        return "missed"
    outside = [e for e in key["effects"] if e["follows"]]
    if outside and len(truth) == len(outside):
        return _outside(outside, findings, named)
    other = {a: e["term"] for e in key["effects"] for a in e["accept"] if a not in truth}
    named = {other.get(n, n) for n in named}
    if named == truth:
        return "extra" if open_end else "right"
    if truth <= named:
        return "extra"
    possible = named | {n for f in findings for n in f["not_excluded"]}
    if truth <= possible or not named:
        return "undecided"
    return "partly" if truth & named else "wrong"


def _outside(effects: list[Json], findings: list[Json], named: set[str]) -> str:
    if named and named <= {a for e in effects for a in e["accept"]}:
        scopes = [scope_right(e, f) for e in effects for f in findings if f["term"] in e["accept"]]
        return "right" if all(scopes) else "undecided"
    if named:
        return "wrong"
    follows = {d for f in findings for d in f["depends_on"]}
    return "right" if all(follows & set(e["follows"]) for e in effects) else "undecided"


def certain_and_wrong(key: Json, found: Json) -> bool:
    """Whether a term is named that is not true, and nothing true is left possible beside it."""
    truth = set(key["terms"]) | {a for e in key["effects"] for a in e["accept"]}
    return any(
        f["term"] != "unknown" and f["term"] not in truth and not truth & set(f["not_excluded"])
        for f in _asserted(key, found)
    )


def by_effect(key: Json, found: Json) -> Iterator[Json]:
    """Every true effect: how it was told, its numbers, its roads and its scope."""
    findings = _asserted(key, found)
    for effect in key["effects"]:
        mine = [f for f in findings if f["term"] in {effect["term"], *effect["accept"]}]
        if effect["follows"] and not mine:
            mine = [
                f
                for f in findings
                if set(f["depends_on"]) & set(effect["follows"]) and f["term"] == "unknown"
            ]
        left_open = any(f["term"] == "unknown" or effect["term"] in f["not_excluded"] for f in findings)
        yield {
            "term": effect["term"],
            "share": effect["oracle"]["share"],
            "told": "named" if mine else "undecided" if left_open else "missed",
            "numbers": [n for f in mine[:1] if scope_right(effect, f) for n in numbers(effect, f)],
            "overlap": overlap(effect, mine[0]) if mine else None,
            "scope": scope_right(effect, mine[0]) if mine else None,
            "late": lateness(key, effect, mine[0]) if mine else None,
        }


def numbers(effect: Json, finding: Json) -> Iterator[Json]:
    """Every true number beside its estimate; none of a drift, which has no one number."""
    if effect["scope"]["drift"] or finding["term"] != effect["term"]:
        return
    given = {p["name"]: p for p in finding["parameters"]}
    truth = effect["parameters"]
    for name, value in truth.items():
        known = [given[a] for a in ALIASES.get(name, (name,)) if a in given]
        if known:
            size = math.hypot(*truth.values()) if effect["term"] == "wind" else abs(value)
            estimate = {k: known[0][k] for k in ("value", "low", "high")}
            yield {"name": name, "truth": value, "size": size, **estimate}


def overlap(effect: Json, finding: Json) -> float | None:
    """Roads named and true over roads named or true; None where the key has no roads."""
    if not effect["roads"]:
        return None
    true = set(effect["roads"])
    edges = finding["where"]["edges"] if finding.get("where") else []
    named = {e["edge_id"].removeprefix("-") for e in edges}
    return len(true & named) / max(len(true | named), 1)


def scope_right(effect: Json, finding: Json) -> bool:
    """Whether the finding tells of the right trucks, and of a change in time only where one is."""
    said, true = finding.get("scope") or {}, effect["scope"]
    if _set(said.get("vehicles")) != _set(true["vehicles"]):
        return False
    if true["drift"]:
        return bool(said.get("drift") or said.get("from") or said.get("until"))
    return all(bool(said.get(side)) == bool(true[side]) for side in ("from", "until"))


def lateness(key: Json, effect: Json, finding: Json) -> float | None:
    """Share of the recording by which the time of the change is off."""
    said, true = finding.get("scope") or {}, effect["scope"]
    off = [
        abs((_time(said[side]) - _time(true[side])).total_seconds()) / key["seconds"]
        for side in ("from", "until")
        if said.get(side) and true[side]
    ]
    return max(off) if off else None


def congestion(key: Json, found: Json) -> Json | None:
    """Share of travel time lost to others, true and told; None where the key has none."""
    if "congestion" not in key:
        return None
    told = [f for f in found["findings"] if f["term"] == "congestion"]
    shares = [p for f in told for p in f["parameters"] if "share" in p["name"] or p["unit"] == "1"]
    return {"truth": key["congestion"]["share"], "told": shares[0]["value"] if shares else None}


def adjusted(key: Json, found: Json) -> list[bool]:
    """Of every number that is wrong in the truck file: whether an adjustment says so, by value or by ratio."""
    out = []
    for wrong in key["adjustments"]:
        mine = [
            a for a in found.get("adjustments", []) if wrong["name"] in a["name"].replace(".", "_").split("_")
        ]
        truths = (wrong["value"], wrong["value"] / wrong["file"], wrong["value"] - wrong["file"])
        out.append(any(a["low"] <= t <= a["high"] for a in mine for t in truths))
    return out


def faults(found: Json) -> list[str]:
    """What no diagnosis may hold: numbers that are none, estimates on their bounds, errors that grew."""
    out = [f"not a number: {'.'.join(path)}" for path, value in _leaves(found) if _not_finite(value)]
    for f in found["findings"]:
        out += [
            f"{f['term']} {p['name']} on its bound"
            for p in f["parameters"]
            if p["value"] in (p["low"], p["high"])
        ]
    return out


def excess(found: Json) -> dict[str, float]:
    """Error of the written model over the noise floor, of the channels that have findings, or of all where none.

    The floor of version 1 is no estimate of the noise.
    """
    if found["format_version"] < 2:
        return {}
    none = found["verdict"] == "none"
    told = {c["name"] for c in found["channels"]} if none else {f["channel"] for f in found["findings"]}
    return {
        c["name"]: c["after"] / c["floor"]
        for c in found["channels"]
        if c["name"] in told and c.get("floor") and c.get("after") is not None
    }


def _asserted(key: Json, found: Json) -> list[Json]:
    """Findings but those that only say what the logger does."""
    allowed = set(key["allowed"]) - set(key["terms"])
    return [f for f in found["findings"] if f["term"] not in allowed]


def _set(values: list[str] | None) -> set[str] | None:
    return set(values) if values else None


def _time(text: str) -> datetime:
    return datetime.fromisoformat(text)


def _leaves(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    items = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    )
    if items is None:
        yield path, value
        return
    for k, v in items:
        yield from _leaves(v, (*path, str(k)))


def _not_finite(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
