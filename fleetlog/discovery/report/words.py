"""Findings in sentences that a fleet engineer understands, from what the terms say of themselves."""

import re
import tomllib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from fleetlog.core.words import percent
from fleetlog.discovery.model import Scope
from fleetlog.discovery.report.finding import Finding, Parameter
from fleetlog.physics.power import all_terms
from fleetlog.physics.term import Term

Told = dict[str, Any] | None  # A place or a scope as the contract writes it; None of all
DOUBTFUL = 0.05  # A finding that trips held out contradict with more chance than this is not confirmed
VARIABLES = tomllib.loads(Path(__file__).with_name("variables.toml").read_text(encoding="utf-8"))


def place(where: Told) -> str:
    """Return on which roads, in a few words."""
    if not where:
        return "everywhere"
    edges = dict.fromkeys(e["edge_id"] for e in where.get("edges", []))
    # One direction by its edge, both by their road.
    roads = [*dict.fromkeys(e.removeprefix("-") if e.removeprefix("-") in edges else e for e in edges)]
    if not roads:
        low_x, low_y, high_x, high_y = where["extent"]
        return f"between x = {low_x:.0f} and {high_x:.0f} m, y = {low_y:.0f} and {high_y:.0f} m"
    named = ", ".join(roads[:3])
    more = len(roads) - 3
    return f"on {'road' if len(roads) == 1 else 'roads'} {named}" + (f" and {more} more" if more > 0 else "")


def said_of_terms() -> dict[str, str]:
    """Return what a user may have in mind who does not know the name of a term, by name."""
    texts = {n: (t.statement, t.advice, *(p.name for p in t.parameters)) for n, t in all_terms().items()}
    return {n: " ".join([n, *text]) for n, text in texts.items()}


def scope(s: Scope, vehicles: Sequence[str]) -> dict[str, Any]:
    """Return whom and when a finding concerns, as the contract writes it."""
    out: dict[str, Any] = {
        "vehicles": [vehicles[v] for v in s.vehicles] or None,
        "from": _moment(s.begin), "until": _moment(s.until),
    }  # fmt: skip
    return {**out, "drift": True} if s.drift else out


def _moment(time: float) -> str | None:
    return datetime.fromtimestamp(round(time), UTC).isoformat() if isfinite(time) else None


def _of(scope: Told, text: str) -> str:
    """A sentence of a scope: after ``Truck T3, from 14 March 2026, 09:00 to 10:00 UTC: ``; of all, always."""
    if scope is None:
        return text
    trucks, begin, until = scope["vehicles"], scope["from"], scope["until"]
    who = f"truck{'s' if len(trucks) > 1 else ''} {', '.join(trucks)}" if trucks else ""
    word = "growing from" if scope.get("drift") else "from" if until else "since"
    when = f"{word} {_said(begin)}" if begin else ""
    when += f"{' to' if when else 'until'} {_said(until)}" if until else ""
    whom = re.sub(r"(\d+ \w+ \d{4}), ([\d:]+) UTC to \1,", r"\1, \2 to", ", ".join(filter(None, (who, when))))
    return f"{whom[:1].upper()}{whom[1:]}: {text[:1].lower()}{text[1:]}" if whom else text


def _said(moment: str) -> str:
    t = datetime.fromisoformat(moment)
    return f"{t.day} {t:%B %Y, %H:%M} UTC"


def statement(term: Term, parameters: list[Parameter], where: Told, scope: Told) -> str:
    """Return the sentence of a term; a term without one gets a plain one."""
    given: dict[str, Any] = {p.name: p for p in parameters}
    for p in term.parameters:
        given.setdefault(p.name, Parameter(p.name, p.neutral, p.neutral, p.neutral, p.unit, p.neutral))
    own = [term.by_name[p.name] for p in parameters if p.name in term.by_name]
    if all(said := [p.sentence or term.sentence for p in own if not p.shape] or [term.sentence]):
        first, *more = dict.fromkeys(said)
        text = "; ".join([first, *(m[:1].lower() + m[1:] for m in more)]).format(where=place(where), **given)
    else:
        numbers = ", ".join(
            f"{p.name} = {p.value:.4g} ({p.low:.4g} to {p.high:.4g}){'' if p.unit == '1' else ' ' + p.unit}"
            for p in parameters
        )
        at = f" {place(where)}" if where else ""
        text = f"{term.statement[:1].upper()}{term.statement[1:]}{at}: {numbers}"
    return _of(scope, re.sub(r"(?<=\d)%", " %", text))


def advice(f: Finding) -> str:
    """Return what to do: of a time, look for what changed; of a term, what it says; of trucks, compare."""
    term = all_terms().get(f.physics or f.term)
    changed = "Find out what changed then" if f.scope["from"] or f.scope["until"] else ""
    others = "Compare with the other trucks: brakes, tyres, drive" if f.scope["vehicles"] else ""
    parts = [said for said in (changed, term.advice if term else others) if said]
    if not parts and f.needs:
        parts = [f"{f.needs[:1].upper()}{f.needs[1:]}"]
    return ". ".join(parts) or "Compare the trucks, places and hours that it follows"


def unknown(depends_on: Sequence[str], where: Told, scope: Told) -> str:
    """Return the sentence of a mismatch that no term explains."""
    at = f", mostly {place(where)}" if where else ""
    return _of(scope, f"A mismatch that no known term explains depends on {_named(depends_on)}{at}")


def slight(term: str | None, depends_on: Sequence[str], share: float, least: float) -> str:
    """Return the sentence of an effect that is no finding: below the least share, or within tolerances."""
    what, moved = term or f"what depends on {_named(depends_on)}", f"{100.0 * share:.1f} % where it acts"
    if share >= least:
        return f"{what} may be wrong ({moved}), but several small errors of other numbers would look the same"
    return f"{what} is significant but small: {moved}; findings begin at {percent(least)}"


def unseen(depends_on: Sequence[str]) -> str:
    """Return the sentence of a mismatch that is no finding: unseen trips do not show it, or no place."""
    return f"some trips differ by what depends on {_named(depends_on)}, but too little for a finding"


def _named(depends_on: Sequence[str]) -> str:
    return " and ".join(s for s in (VARIABLES.get(d, d.replace("_", " ")) for d in depends_on) if s)


def onward(f: Finding, name: Callable[[str], str] = str) -> str:
    """Return what cannot be told from a finding, or that unseen trips do not confirm it, and what would."""
    if f.not_excluded:
        parts = [(n, n.removeprefix("unknown(").removesuffix(")").split(",")) for n in f.not_excluded]
        others = ", ".join(f"something that follows {_named(s)}" if [n] != s else name(n) for n, s in parts)
        return f"These data cannot tell it from {others}. To tell them apart: {f.needs or 'record more'}."
    # Time lost to others is told from other windows than the error after it: there chance decides.
    if (f.evidence.get("held_out_gain") or 0.0) < 0.0 and not (f.evidence.get("p_value") or 1.0) < DOUBTFUL:
        return "The trips held out do not confirm it: record more there before you act on it."
    # Where nothing else can be done, what to do says it.
    return f"Next: {f.needs}." if f.needs and f.needs[1:] not in advice(f) else ""


def needs(term: str | None, others: Sequence[str]) -> str | None:
    """Return what recording would tell a finding from those that are not excluded."""
    known = all_terms()
    named = [n for n in ([term] if term else []) + list(others) if n in known and known[n].needs]
    if not others and term:
        return None
    if not named:
        return "record trips in which this varies more, or add a term of your own"
    return "; ".join(dict.fromkeys(known[n].needs for n in named))
