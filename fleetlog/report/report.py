"""One page about a fleet, or about two datasets side by side."""

import inspect
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fleetlog.analysis.tariff import load_tariff
from fleetlog.core.result import EdgeValues, Grid, Result
from fleetlog.core.schema import Wrong, time_zone
from fleetlog.core.truck import Truck
from fleetlog.core.words import count
from fleetlog.errors import ArgumentError, DataError
from fleetlog.registry import added, part
from fleetlog.report.comparison import Comparison
from fleetlog.report.content import Part, Section, render
from fleetlog.report.facts import Facts, gather
from fleetlog.report.sections import SECTIONS, answers, local_span, shapes
from fleetlog.store import Dataset
from fleetlog.version import __version__
from fleetlog.view.scales import Scale, scale_of


@dataclass
class Report:
    """What a report says: ``html`` (one page), ``summary`` (JSON-ready), ``tables`` and ``lines``."""

    html: str
    summary: dict[str, Any]
    tables: dict[str, pd.DataFrame]
    lines: list[str]
    zone: str


def report(
    datasets: Sequence[Dataset], *, truck: Truck | None = None, tariff: Path | None = None,
    timezone: str | None = None, diagnosis: bool = True,
) -> Report:  # fmt: skip
    """Report on one dataset, or compare two.

    Parameters
    ----------
    datasets : one or two, recorded or simulated; of two, differences are those of the second from the first.
    truck : gives energy by cause, and what its model leaves out.
    tariff : file of prices and carbon intensity by hour; see :mod:`fleetlog.analysis.tariff`.
    timezone : of the hours, as ``Europe/Berlin``; that of the first dataset's site by default.
    diagnosis : whether to run the diagnosis of recordings where a truck is given; it takes longest.

    Raises
    ------
    ArgumentError
        There are no datasets or more than two, or the time zone is none.
    InputError
        A file is at fault.
    """
    if not 1 <= len(datasets) <= 2:
        raise ArgumentError(f"a report takes one or two datasets, not {len(datasets)}")
    zone = _zone(timezone, datasets[0])
    prices = None if tariff is None else load_tariff(tariff)
    names = _names(datasets)
    facts = [gather(Facts(n, d, zone, truck, prices)) for n, d in zip(names, datasets, strict=True)]
    left_out = [_left_out(f) for f in facts] if diagnosis and truck is not None else []
    found = Comparison(facts, left_out)
    lead = found.changes() if found.two else answers(facts[0])
    return Report(_page(found, lead), _summary(found, lead), _tables(found), lead, zone)


def _zone(given: str | None, first: Dataset) -> str:
    try:
        return time_zone(given or first.site.timezone)
    except Wrong as wrong:
        raise ArgumentError(f"{given!r} {wrong}", option="--timezone") from None


def _names(datasets: Sequence[Dataset]) -> list[str]:
    """Names of the folders; told apart by their number where they are the same."""
    names = [d.path.resolve().name for d in datasets]
    return names if len(set(names)) == len(names) else [f"{n} ({i})" for i, n in enumerate(names, start=1)]


def _left_out(facts: Facts) -> list[str]:
    """The diagnosis in three sentences; none for a simulation."""
    from fleetlog.report.diagnosis import in_short

    return in_short(facts) if facts.dataset.kind == "recorded" else []


def _page(found: Comparison, lead: list[str]) -> str:
    facts = found.facts
    sites = list(dict.fromkeys(f.site.name if f.site.source else f.name for f in facts))
    large = [(f, v[0]) for f, v in found.figures if f.title and np.isfinite(v[0])]
    tiles = [(f.label, f.shown(v), "" if f.unit == "1/h" else found.unit(f)) for f, v in large]
    return render(
        "fleet.html", title=f"Fleet report: {' and '.join(sites)}", lead=lead,
        about=[_about(f) for f in facts], tiles=[] if found.two else tiles, sections=_sections(found),
        key=found.table(), version=__version__,
    )  # fmt: skip


def _about(f: Facts) -> list[tuple[str, str]]:
    """Dataset, site, period, trucks, truck file, tariff and version."""
    made = f.dataset.meta["provenance"].get("version", "an unknown version")
    return [
        ("Dataset", f"{f.name} ({f.dataset.kind})"), ("Site", f.site.name), ("Period", local_span(f)),
        ("Trucks", f"{count(len(f.dataset.vehicles), 'truck')}, {count(f.dataset.rows, 'row')}"),
        ("Truck file", f.truck.name if f.truck else "none given"),
        ("Tariff", f.tariff.name if f.tariff else "none given"),
        ("Made by", f"fleetlog {__version__}, from a dataset of fleetlog {made}"),
    ]  # fmt: skip


def _sections(found: Comparison) -> list[Section]:
    facts = found.facts
    out = []
    for title, make in SECTIONS.items():
        shared = _common(title, facts)
        out.append(Section(title, [replace(make(f, **shared), name=f.name) for f in facts]))
        if title == "Energy" and any(found.left_out):
            said = zip(facts, found.left_out, strict=True)
            parts = [Part(lines, name=f.name) for f, lines in said if lines]
            out.append(Section("What the truck model leaves out", parts))
    return out + _added_sections(facts)


def _added_sections(facts: list[Facts]) -> list[Section]:
    """A section for each analysis that another package adds: its sentences."""
    found: dict[str, list[Part]] = {}
    for f in facts:
        for result in added_results(f.dataset, f.truck):
            found.setdefault(result.name, []).append(Part(result.lines, name=f.name))
    return [Section(name.replace("_", " ").capitalize(), parts) for name, parts in found.items()]


def added_results(dataset: Dataset, truck: Truck | None = None) -> Iterator[Result]:
    """Give the result of every added analysis that these data can answer."""
    for name in added("fleetlog.analysis"):
        function = part("fleetlog.analysis", "ANALYSIS", name)
        needed = [p.name for p in inspect.signature(function).parameters.values() if p.default is p.empty][1:]
        options: dict[str, Any] = {} if truck is None or "truck" not in needed else {"truck": truck}
        if set(needed) <= options.keys():
            try:
                yield function(dataset, **options)
            except DataError:  # these data cannot answer it
                continue


def _common(title: str, facts: list[Facts]) -> dict[str, Scale]:
    """One colour scale for the maps of both datasets."""
    name, kind = {"Places": ("heatmap", Grid), "Congestion": ("density", EdgeValues)}.get(title, ("", Grid))
    drawn = [s for f in facts for s in shapes(f, name, kind)[:1] if isinstance(s, Grid | EdgeValues)]
    return {"scale": scale_of(np.concatenate([np.ravel(s.values) for s in drawn]))} if len(drawn) > 1 else {}


def _summary(found: Comparison, lead: list[str]) -> dict[str, Any]:
    datasets = [
        {
            "name": f.name, "path": str(f.dataset.path), "kind": f.dataset.kind, "site": f.site.name,
            **{k: f.dataset.meta[k] for k in ("start", "end")}, "vehicles": len(f.dataset.vehicles),
            "figures": {figure.name: values[k] for figure, values in found.figures},
            "left_out": found.left_out[k] if found.left_out else None, "not_judged": f.missing,
        }
        for k, f in enumerate(found.facts)
    ]  # fmt: skip
    differences = {name: {**asdict(d), "p_value": p} for name, (d, p) in found.differences.items()}
    units = {figure.name: found.unit(figure) for figure, _ in found.figures}
    return {
        "format_version": 1, "timezone": found.facts[0].zone, "datasets": datasets, "units": units,
        "differences": differences or None, "answer": lead,
    }  # fmt: skip


PLACES = {"speeding": "speeding", "near_misses": "near_misses", "places": "stops", "areas": "density"}
"""Tables of the report, and the result that each is of."""


def _tables(found: Comparison) -> dict[str, pd.DataFrame]:
    """All tables; those of two datasets are one below the other, told apart by the column ``dataset``."""
    out: dict[str, list[pd.DataFrame]] = {}
    for f in found.facts:
        own = {"ledger": f.ledger.reset_index(), "states": f.results["utilisation"].tables["states"]}
        results = {name: f.results[of].places for name, of in PLACES.items() if of in f.results}
        own |= {name: tables[name] for name, tables in results.items() if name in tables}
        if "trips" in f.results:
            own["trips_between_places"] = f.results["trips"].tables["pairs"]
        for name, table in own.items():
            out.setdefault(name, []).append(table.assign(dataset=f.name) if found.two else table)
    return {"figures": found.frame(), **{n: pd.concat(t, ignore_index=True) for n, t in out.items()}}
