"""What the truck model leaves out: in three sentences for a fleet report, and as the page of a diagnosis."""

from __future__ import annotations

from typing import Any

import numpy as np

from fleetlog.core.result import EdgeValues, Grid, Result, Series
from fleetlog.core.site import Site
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.report.finding import Finding
from fleetlog.discovery.report.output import HEADS, shapes
from fleetlog.errors import DataError
from fleetlog.listening import progress
from fleetlog.report.content import Picture, Table, render
from fleetlog.report.facts import Facts
from fleetlog.view.picture import svg
from fleetlog.view.scales import scales_of

MOST_ROADS = 20


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
    count = len(v.findings)
    out = [HEADS.get(v.word, f"The truck model leaves out {count} effect{'s' if count > 1 else ''}.")]
    if v.findings:
        out.append(f"{'The strongest: ' if count > 1 else ''}{v.findings[0].statement}.")
    judged = [c for c in v.channels if c.judged]
    if judged:
        c = judged[0]
        out.append(
            f"On trips that it has not seen, the error of {c.name.replace('_', ' ')} is {_share(c.before)} "
            f"without and {_share(c.after)} with what was found; noise alone makes {_share(c.floor)}."
        )
    return out


def diagnosis_page(d: Diagnosis, site: Site) -> str:
    """``report.html`` of a diagnosis."""
    v = d.verdict
    drawn = Result("diagnosis", {}, shapes=shapes(d))
    head = HEADS.get(v.word, "The model leaves out what is named below.")
    return render(
        "diagnosis.html", title="Differences between recording and model", lead=head, channels=_channels(d),
        findings=[(f, _sentence(f), _parameters(f), _ranking(f), _roads(f)) for f in v.findings],
        pictures=_pictures(drawn, site), notes=v.notes,
    )  # fmt: skip


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
        [c.name, c.metric, _share(c.before), _share(c.after), _share(c.floor)] for c in d.verdict.channels
    ]
    head, right = ["Channel", "Error", "before", "after", "noise floor"], [False, False, True, True, True]
    return Table(head, rows, right, "How well the model reproduces trips that it has not seen")


def _share(value: float | None) -> str:
    return "not judged" if value is None or not np.isfinite(value) else f"{100.0 * value:.1f} %"


def _sentence(f: Finding) -> str:
    """What cannot be told from it, and what would."""
    if f.not_excluded:
        others = ", ".join(n.replace("_", " ") for n in f.not_excluded)
        return f"These data cannot tell it from {others}. To tell them apart: {f.needs or 'record more'}."
    return f"To go on: {f.needs}." if f.needs else ""


def _parameters(f: Finding) -> Table | None:
    rows = [[p.name, f"{p.value:.4g}", f"{p.low:.4g} to {p.high:.4g}", p.unit] for p in f.parameters]
    head = ["Quantity", "value", "95 % interval", "unit"]
    return Table(head, rows, [False, True, True, False]) if rows else None


def _ranking(f: Finding) -> list[tuple[str, float, float, bool]]:
    """Explanations with what each takes off the error on held-out trips, and its share of the largest."""
    others: list[dict[str, Any]] = f.evidence.get("alternatives", [])
    rows = [(f.term, float(f.evidence.get("held_out_gain") or 0.0), True)]
    rows += [(str(a["term"]), float(a["held_out_gain"] or 0.0), False) for a in others]
    top = max(abs(g) for _, g, _ in rows)
    if top <= 0.0 or len(rows) < 2:
        return []
    return [(n.replace("_", " "), g, 100.0 * max(g, 0.0) / top, own) for n, g, own in rows]


def _roads(f: Finding) -> Table | None:
    edges = (f.where or {}).get("edges") or []
    rows = [
        [e["edge_id"], f"{e['from']:.0f} to {e['to']:.0f} m", f"{e['value']:.4g}",
         f"{e['low']:.4g} to {e['high']:.4g}"]
        for e in edges[:MOST_ROADS]
    ]  # fmt: skip
    head, right = ["Road", "stretch", "value", "95 % interval"], [False, True, True, True]
    return Table(head, rows, right, "Where", max(len(edges) - MOST_ROADS, 0)) if rows else None
