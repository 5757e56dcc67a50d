"""What the truck model leaves out: in three sentences for a fleet report, and as the page of a diagnosis."""

import numpy as np
import pandas as pd

from fleetlog.core.result import EdgeValues, Grid, Result, Series
from fleetlog.core.site import Site
from fleetlog.core.words import Sentences, percent
from fleetlog.discovery.diagnose import Diagnosis, diagnose
from fleetlog.discovery.report.finding import Finding
from fleetlog.discovery.report.output import head
from fleetlog.discovery.report.words import advice, onward, place
from fleetlog.errors import DataError
from fleetlog.listening import progress
from fleetlog.physics.power import all_terms
from fleetlog.report.content import Picture, Table, number, render
from fleetlog.report.facts import Facts
from fleetlog.report.sections import local_span
from fleetlog.store import Dataset
from fleetlog.version import __version__
from fleetlog.view.palette import scales_of
from fleetlog.view.picture import svg

SAID = Sentences(__file__)
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
    out = [head(v)]
    if v.findings:
        first = v.findings[0]
        out.append(f"{'The largest: ' if v.findings[1:] else ''}{first.statement}. {advice(first)}.")
    for c in [c for c in v.channels if c.judged][:1]:
        # Of a short log the noise is known roughly: one above the error says no more than that.
        lower = c.after is not None and c.floor is not None and c.floor < c.after
        noise = f"; noise alone makes {_share(c.floor)}" if lower else ", no more than noise alone may make"
        before, after = _share(c.before), _share(c.after)
        out.append(SAID("unseen", channel=_plain(c.name), before=before, after=after, noise=noise))
    return out


def diagnosis_page(d: Diagnosis, drawn: Result, site: Site, dataset: Dataset) -> str:
    """``report.html`` of a diagnosis, with the pictures of its result."""
    v = d.verdict
    rows = [[_plain(c.name), c.metric, *map(_share, (c.before, c.after, c.floor))] for c in v.channels]
    columns, right = ["Channel", "Error", "before", "after", "noise floor"], [False, False, True, True, True]
    judged = Table(columns, rows, right, "How well the model reproduces trips that it has not seen")
    untold = [(c.name, c.reason) for c in v.channels if c.reason]
    return render(
        "diagnosis.html", title="Differences between recording and model", lead=[head(v), *_cost(d)],
        dataset=dataset, version=__version__, span=local_span(Facts("", dataset, site.timezone or "UTC")),
        site=site.name, channels=judged, todo=_todo(v.findings, site.timezone or "UTC"),
        findings=[(f, onward(f, _plain), _ranking(f), _roads(f)) for f in v.findings],
        pictures=_pictures(drawn, site), notes=v.notes + [f"{_plain(n)}: {why}" for n, why in untold],
    )  # fmt: skip


def _cost(d: Diagnosis) -> list[str]:
    """What the effects found add to the energy of the recording."""
    e = d.channels.get("battery_power") or d.channels.get("soc")
    if e is None or e.bare is None or all(f.term == "unknown" for f in e.findings):
        return []
    channel, added, whole = e.problem.channel, 0.0, 0.0
    for unit in channel.units():
        more = channel.predict(unit, e.after) - channel.predict(unit, e.bare)
        added, whole = added + float(more[unit.whole].sum()), whole + float(unit.recorded[unit.whole].sum())
    if not whole > 0.0:
        return []
    kwh, of = number(abs(added) / KJ_PER_KWH), number(whole / KJ_PER_KWH)
    does, share = "add" if added > 0.0 else "take", abs(added) / whole
    return [SAID("cost", does=does, kwh=kwh, share=share, of=of)]


def _todo(findings: list[Finding], zone: str) -> Table | None:
    """Whom each finding concerns, where, when, and what to do about it."""
    rows = [
        [f"{k}. {_plain(f.term).capitalize()}", ", ".join(f.scope["vehicles"] or ()) or "all", place(f.where),
         _when(f, zone), f"{advice(f)}."]
        for k, f in enumerate(findings, start=1)
    ]  # fmt: skip
    head = ["Finding", "trucks", "where", "when", "what to do"]
    return Table(head, rows, [False] * 5, "What to do, the largest effect first") if rows else None


def _plain(name: str) -> str:
    return "state of charge" if name == "soc" else name.replace("_", " ")


def _when(f: Finding, zone: str) -> str:
    """The time that a finding is of, on the site's clock."""
    begin, end = (f.scope[k] and pd.Timestamp(f.scope[k]).tz_convert(zone) for k in ("from", "until"))
    said = "growing " if begin and f.scope.get("drift") else ""
    if begin:
        said += f"from {begin:%d %b %Y %H:%M}"
    if end:
        one_day = begin and begin.date() == end.date()
        said += f"{' to' if begin else 'until'} {end:{'' if one_day else '%d %b %Y '}%H:%M}"
    return f"{said} ({zone})" if said else "always"


def _pictures(result: Result, site: Site) -> list[Picture]:
    """Mismatch before and after in one colour scale, and the trip that the model missed most."""
    scales = scales_of(result.shapes)
    words = {"worst trip": "Power on the trip that the model missed most"}
    kinds = (Grid, Series) if site.network is None else (Grid, Series, EdgeValues)
    drawn = [s for s in result.shapes if isinstance(s, kinds)]
    pictures = ((s.name, svg(result, site, s, salt=s.name, scale=scales.get(s.name))) for s in drawn)
    return [Picture(picture, words.get(name, name.capitalize())) for name, picture in pictures]


def _share(value: float | None) -> str:
    return "not judged" if value is None or not np.isfinite(value) else percent(value, 1)


def _ranking(f: Finding) -> list[tuple[str, str, float, bool]]:
    """Explanations with what each takes off the error on held-out trips, and its share of the largest."""
    gains: dict[str, float] = {}
    for other in f.evidence.get("alternatives", []):
        gain = float(other["held_out_gain"] or 0.0)
        gains[other["term"]] = max(gain, gains.get(other["term"], gain))
    gains[f.term] = float(f.evidence.get("held_out_gain") or 0.0)
    top = max(gains.values())
    if top <= 0.0 or len(gains) < 2:
        return []
    rows = sorted(gains.items(), key=lambda item: -item[1])
    return [(_plain(n), percent(g, 1), 100.0 * max(g, 0.0) / top, n == f.term) for n, g in rows]


def _roads(f: Finding) -> Table | None:
    edges, term = (f.where or {}).get("edges") or [], all_terms().get(f.term)
    if not edges:
        return None
    # A factor of 2.3 is told so, any other number without a unit as a share.
    first = term.parameters[0] if term is not None and term.parameters else None
    free = "mismatch", "1" if f.channel == "speed" else "W"
    name, unit = free if first is None else (first.name, first.unit)
    factor, unit = (100.0, "%") if unit == "1" and name != "factor" else (1.0, unit)
    rows = [
        [e["edge_id"], f"{e['from']:.0f} to {e['to']:.0f}",
         *(f"{float(f'{factor * e[k]:.3g}'):,g}" for k in ("value", "low", "high"))]
        for e in edges[:MOST_ROADS]
    ]  # fmt: skip
    head = ["Road", "stretch [m]", name if unit == "1" else f"{name} [{unit}]", "95 % from", "to"]
    return Table(head, rows, [False, *[True] * 4], "Where", max(len(edges) - MOST_ROADS, 0))
