"""What the truck model leaves out: in three sentences for a fleet report, and as the page of a diagnosis."""

from typing import Any

import numpy as np
import pandas as pd

from fleetlog.core.result import EdgeValues, Grid, Result, Series
from fleetlog.core.site import Site
from fleetlog.core.words import count, percent
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.report.finding import Finding
from fleetlog.discovery.report.output import HEADS, shapes
from fleetlog.discovery.report.words import place
from fleetlog.errors import DataError
from fleetlog.listening import progress
from fleetlog.physics.power import all_terms
from fleetlog.report.content import Picture, Table, number, render
from fleetlog.report.facts import Facts
from fleetlog.view.picture import svg
from fleetlog.view.scales import scales_of

MOST_ROADS, KJ_PER_KWH = 20, 3600.0


def in_short(facts: Facts) -> list[str]:
    """The verdict, the strongest finding, and how well the model does with and without what was found."""
    assert facts.truck is not None

    def say(step: str) -> None:
        progress(f"{facts.name}: diagnosis, {step}", 0.0)

    try:
        found = diagnose(facts.dataset, facts.truck, progress=say)
    except DataError as error:
        return [f"The diagnosis could not be made: {error.advice}."]
    v = found.verdict
    out = [HEADS.get(v.word, f"The truck model leaves out {count(len(v.findings), 'effect')}.")]
    if v.findings:
        first = v.findings[0]
        out.append(f"{'The largest: ' if v.findings[1:] else ''}{first.statement}. {_advice(first)}.")
    judged = [c for c in v.channels if c.judged]
    if judged:
        c = judged[0]
        out.append(
            f"On trips that it has not seen, the error of {_plain(c.name)} is {_share(c.before)} "
            f"without and {_share(c.after)} with what was found; noise alone makes {_share(c.floor)}."
        )
    return out


def diagnosis_page(d: Diagnosis, site: Site) -> str:
    """``report.html`` of a diagnosis."""
    v = d.verdict
    drawn = Result("diagnosis", {}, shapes=shapes(d))
    head = HEADS.get(v.word, f"The truck model leaves out {count(len(v.findings), 'effect')}.")
    return render(
        "diagnosis.html", title="Differences between recording and model", lead=[head, *_cost(d)],
        channels=_channels(d), todo=_todo(v.findings, site.timezone or "UTC"),
        findings=[(f, _sentence(f), _ranking(f), _roads(f)) for f in v.findings],
        pictures=_pictures(drawn, site), notes=v.notes,
    )  # fmt: skip


def _cost(d: Diagnosis) -> list[str]:
    """What the effects found add to the energy of the recording."""
    e = d.channels.get("battery_power") or d.channels.get("soc")
    if e is None or not e.findings:
        return []
    channel, added, whole = e.problem.channel, 0.0, 0.0
    for unit in channel.units():
        more = channel.predict(unit, e.after) - channel.predict(unit, e.before)
        added, whole = added + float(more[unit.whole].sum()), whole + float(unit.recorded[unit.whole].sum())
    if not whole > 0.0:
        return []
    word = "add" if added > 0.0 else "take"
    share, kwh = percent(abs(added) / whole, 1), abs(added) / KJ_PER_KWH
    return [
        f"Together they {word} {number(kwh)} kWh: {share} of the {number(whole / KJ_PER_KWH)} kWh recorded."
    ]


def _todo(findings: list[Finding], zone: str) -> Table | None:
    """Whom each finding concerns, where, when, and what to do about it."""
    rows = []
    for k, f in enumerate(findings, start=1):
        trucks = ", ".join(f.scope["vehicles"] or ()) or "all"
        rows.append(
            [f"{k}. {_plain(f.term).capitalize()}", trucks, place(f.where), _when(f, zone), f"{_advice(f)}."]
        )
    head = ["Finding", "trucks", "where", "when", "what to do"]
    return Table(head, rows, [False] * 5, "What to do, the largest effect first") if rows else None


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _when(f: Finding, zone: str) -> str:
    """The time that a finding is of, on the site's clock."""
    begin, end = (f.scope[k] and pd.Timestamp(f.scope[k]).tz_convert(zone) for k in ("from", "until"))
    one_day = begin and end and begin.date() == end.date()
    first = f"{'growing ' if f.scope.get('drift') else ''}from {begin:%d %b %Y %H:%M}" if begin else ""
    last = (
        f"{'to' if begin else 'until'} {f'{end:%H:%M}' if one_day else f'{end:%d %b %Y %H:%M}'}"
        if end
        else ""
    )
    said = " ".join(filter(None, (first, last)))
    return f"{said} ({zone})" if said else "always"


def _advice(f: Finding) -> str:
    """What to do: of a time, look for what changed; of a term, what it says; else what to record."""
    term = all_terms().get(f.term)
    parts = ["Find out what changed then"] if f.scope["from"] or f.scope["until"] else []
    parts += [term.advice] if term is not None and term.advice else []
    if not parts and f.needs:
        parts = [f"{f.needs[:1].upper()}{f.needs[1:]}"]
    return ". ".join(parts) or "Compare the trucks, places and hours that it follows"


def _pictures(result: Result, site: Site) -> list[Picture]:
    """Mismatch before and after in one colour scale, and the trip that the model missed most."""
    scales = scales_of(result.shapes)
    words = {"worst trip": "Power on the trip that the model missed most"}
    kinds = (Grid, Series) if site.network is None else (Grid, Series, EdgeValues)
    return [
        Picture(
            svg(result, site, s, salt=s.name, scale=scales.get(s.name)),
            words.get(s.name, s.name.capitalize()),
        )
        for s in result.shapes
        if isinstance(s, kinds)
    ]


def _channels(d: Diagnosis) -> Table:
    rows = [
        [_plain(c.name), c.metric, _share(c.before), _share(c.after), _share(c.floor)]
        for c in d.verdict.channels
    ]
    head, right = ["Channel", "Error", "before", "after", "noise floor"], [False, False, True, True, True]
    return Table(head, rows, right, "How well the model reproduces trips that it has not seen")


def _share(value: float | None) -> str:
    return "not judged" if value is None or not np.isfinite(value) else f"{100.0 * value:.1f} %"


def _sentence(f: Finding) -> str:
    """What cannot be told from it, and what would."""
    if f.not_excluded:
        others = ", ".join(_plain(n) for n in f.not_excluded)
        return f"These data cannot tell it from {others}. To tell them apart: {f.needs or 'record more'}."
    return f"To go on: {f.needs}." if f.needs else ""


def _ranking(f: Finding) -> list[tuple[str, str, float, bool]]:
    """Explanations with what each takes off the error on held-out trips, and its share of the largest."""
    gains: dict[str, float] = {}
    others: list[dict[str, Any]] = f.evidence.get("alternatives", [])
    for name, gain in ((str(a["term"]), float(a["held_out_gain"] or 0.0)) for a in others):
        gains[name] = max(gain, gains.get(name, gain))
    gains[f.term] = float(f.evidence.get("held_out_gain") or 0.0)
    top = max(gains.values())
    if top <= 0.0 or len(gains) < 2:
        return []
    rows = sorted(gains.items(), key=lambda item: -item[1])
    return [(_plain(n), percent(g, 1), 100.0 * max(g, 0.0) / top, n == f.term) for n, g in rows]


def _roads(f: Finding) -> Table | None:
    edges = (f.where or {}).get("edges") or []
    rows = [
        [e["edge_id"], f"{e['from']:.0f} to {e['to']:.0f} m", f"{e['value']:.3g}",
         f"{e['low']:.3g} to {e['high']:.3g}"]
        for e in edges[:MOST_ROADS]
    ]  # fmt: skip
    head, right = ["Road", "stretch", "value", "95 % interval"], [False, True, True, True]
    return Table(head, rows, right, "Where", max(len(edges) - MOST_ROADS, 0)) if rows else None
